// Which engine renders which camera.
#include "capture-bridge/engines.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "liveness.h"

namespace splatbus::capture_bridge::test {
namespace {

using Sets = std::map<std::string, std::vector<CameraRequest>>;
using testing::ElementsAre;

constexpr std::int64_t kSecond = 1'000'000'000;

void hear(Engines& engines, const std::vector<Node>& nodes, std::int64_t broker_age_ns = 10 * kSecond) {
  with_liveness(
      nodes, 0, [&](const wire::Liveness& liveness) { engines.take(liveness); }, broker_age_ns);
}

void add(std::vector<CameraRequest>& requests, CameraRole role, std::uint32_t count) {
  for (std::uint32_t id = 0; id < count; ++id) {
    CameraRequest request{.request_id = requests.size() + 1};
    request.camera.role = role;
    request.camera.id = id;
    requests.push_back(request);
  }
}

/// By camera, who renders it; fails where two do.
std::map<std::pair<CameraRole, std::uint32_t>, std::string> owners(const Sets& sets) {
  std::map<std::pair<CameraRole, std::uint32_t>, std::string> found;
  for (const auto& [engine, requests] : sets) {
    for (const CameraRequest& request : requests) {
      EXPECT_TRUE(found.emplace(std::pair(request.camera.role, request.camera.id), engine).second);
    }
  }
  return found;
}

TEST(Engines, OneAloneIsAskedAsEver) {
  Engines engines;
  EXPECT_TRUE(engines.leads("anybody"));
  hear(engines, {{"a"}, {.name = "b", .kind = "trainer"}, {.name = "c", .alive = false}});
  EXPECT_TRUE(engines.leads("a"));
  EXPECT_FALSE(engines.leads("c"));
  EXPECT_FALSE(engines.shared());
  EXPECT_FALSE(engines.take_changed());
}

TEST(Engines, ABrokerThatWasStartedAgainTakesNobodysPlaceAwayBeforeItHasHeardAll) {
  Engines engines;
  hear(engines, {{"a", 1}, {"b", 2}}, kSecond / 2);
  EXPECT_TRUE(engines.leads("a"));
  hear(engines, {{"b", 2}}, kSecond - 1);
  EXPECT_TRUE(engines.leads("a"));
  hear(engines, {{"b", 2}}, kSecond);
  EXPECT_TRUE(engines.leads("b"));
}

TEST(Engines, CamerasAreDividedEvenlyAndWhatGoesWithTheSceneIsTheLeads) {
  std::vector<CameraRequest> requests;
  add(requests, CameraRole::Input, 24);
  add(requests, CameraRole::Reference, 9);
  add(requests, CameraRole::Light, 3);
  add(requests, CameraRole::Probe, 6);
  Engines engines;
  hear(engines, {{"b", 7}, {"c", 2}, {"a", 5}});
  EXPECT_TRUE(engines.shared());
  EXPECT_TRUE(engines.take_changed());
  EXPECT_FALSE(engines.take_changed());
  EXPECT_TRUE(engines.leads("c"));
  EXPECT_FALSE(engines.leads("a"));
  const Sets sets = engines.divide(requests, 0);
  EXPECT_EQ(owners(sets).size(), requests.size());
  for (const auto& [engine, share] : sets) EXPECT_EQ(share.size(), 14U) << engine;
  for (const auto& [camera, owner] : owners(sets)) {
    EXPECT_TRUE(camera.first == CameraRole::Input || camera.first == CameraRole::Reference || owner == "c");
  }
}

TEST(Engines, OnlyThoseOfOneThatGoesMoveAndOneThatComesTakesItsPart) {
  std::vector<CameraRequest> requests;
  add(requests, CameraRole::Input, 12);
  add(requests, CameraRole::Reference, 6);
  Engines engines;
  hear(engines, {{"a", 1}, {"b", 2}, {"c", 3}});
  const auto three = owners(engines.divide(requests, 0));
  hear(engines, {{"a", 1}, {.name = "b", .epoch = 2, .alive = false}, {"c", 3}});
  EXPECT_TRUE(engines.take_changed());
  const Sets sets = engines.divide(requests, 0);
  EXPECT_TRUE(sets.at("b").empty());  // it may be away for a moment only, and would render what it was asked for
  for (const auto& [camera, owner] : owners(sets)) {
    EXPECT_TRUE(three.at(camera) == "b" || three.at(camera) == owner);
  }
  EXPECT_EQ(sets.at("a").size(), 9U);
  EXPECT_FALSE(engines.divide(requests, 0).contains("b"));
  hear(engines, {{"a", 1}, {"c", 3}, {"d", 4}});
  for (const auto& [engine, share] : engines.divide(requests, 0)) {
    EXPECT_EQ(share.size(), 6U) << engine;
    const auto is_reference = [](const CameraRequest& request) { return request.camera.role == CameraRole::Reference; };
    EXPECT_EQ(std::ranges::count_if(share, is_reference), 2) << engine;
  }
  // A camera that is asked for anew stays, and one that is new goes where there are fewest.
  const auto before = owners(engines.divide(requests, 0));
  for (CameraRequest& request : requests) request.request_id += 100;
  std::erase_if(requests, [&](const CameraRequest& request) {
    return before.at({request.camera.role, request.camera.id}) == "d";
  });
  const std::size_t left = requests.size();
  add(requests, CameraRole::Reference, 20);
  requests.erase(requests.begin() + static_cast<std::ptrdiff_t>(left), requests.end() - 1);
  const auto after = owners(engines.divide(requests, 0));
  for (const auto& [camera, owner] : after) {
    EXPECT_EQ(owner, before.contains(camera) ? before.at(camera) : "d") << camera.second;
  }
  hear(engines, {});
  for (const auto& [engine, share] : engines.divide(requests, 0)) EXPECT_TRUE(share.empty()) << engine;
}

TEST(Engines, OneThatBringsNothingRestsEachTimeLongerAndComesBackBehindTheOthers) {
  std::vector<CameraRequest> requests;
  add(requests, CameraRole::Reference, 4);
  Engines engines;
  hear(engines, {{"a", 1}, {"b", 2}});
  std::int64_t now_ns = kSecond;
  const auto in_use = [&] {
    std::vector<std::string> names;
    for (const auto& [engine, share] : engines.divide(requests, now_ns)) {
      if (!share.empty()) names.push_back(engine);
    }
    return names;
  };
  EXPECT_THAT(in_use(), ElementsAre("a", "b"));
  engines.brought("b", now_ns);
  now_ns += Engines::kPatienceNs;
  engines.update(now_ns);
  EXPECT_THAT(in_use(), ElementsAre("a", "b"));
  ++now_ns;
  engines.update(now_ns);
  EXPECT_EQ(engines.resting(), 1U);
  EXPECT_TRUE(engines.leads("b"));  // who leads must bring something, too
  EXPECT_THAT(in_use(), ElementsAre("b"));
  hear(engines, {{"a", 1}, {"b", 2}});
  EXPECT_EQ(engines.resting(), 1U);  // that it is heard is no reason
  engines.brought("b", now_ns);
  now_ns += Engines::kRestNs;
  engines.update(now_ns - 1);
  EXPECT_EQ(engines.resting(), 1U);
  engines.update(now_ns);
  EXPECT_THAT(in_use(), ElementsAre("a", "b"));
  EXPECT_TRUE(engines.leads("b"));
  engines.brought("b", now_ns);
  now_ns += Engines::kPatienceNs + 1;
  engines.update(now_ns);
  EXPECT_EQ(engines.resting(), 1U);
  engines.update(now_ns + Engines::kRestNs);
  EXPECT_EQ(engines.resting(), 1U);
  engines.update(now_ns + 2 * Engines::kRestNs);
  EXPECT_EQ(engines.resting(), 0U);
}

TEST(Engines, OneThatStopsAmidPicturesThatComeAtARateRests) {
  std::vector<CameraRequest> requests;
  add(requests, CameraRole::Reference, 4);
  for (CameraRequest& request : requests) request.rate_hz = request.camera.id < 2 ? 0.5F : 0.1F;
  Engines engines;
  hear(engines, {{"a", 1}, {"b", 2}});
  std::int64_t now_ns = kSecond;
  static_cast<void>(engines.divide(requests, now_ns));
  engines.brought("a", now_ns);
  engines.brought("b", now_ns);
  const std::int64_t due_ns = now_ns + 2 * kSecond + Engines::kPatienceNs;
  engines.brought("a", due_ns);
  engines.update(due_ns);
  EXPECT_EQ(engines.resting(), 0U);
  engines.update(due_ns + 1);
  EXPECT_EQ(engines.resting(), 1U);
  EXPECT_TRUE(engines.leads("a"));
}

TEST(Engines, WhoHasBroughtAllThatItWasAskedForMayRestItsHands) {
  std::vector<CameraRequest> requests;
  add(requests, CameraRole::Reference, 4);
  for (CameraRequest& request : requests) request.rate_hz = 1;
  Engines engines;
  hear(engines, {{"a", 1}, {"b", 2}});
  static_cast<void>(engines.divide(requests, kSecond));
  engines.brought("a", kSecond);
  engines.brought("b", kSecond);
  // From now on each is for one picture.
  for (CameraRequest& request : requests) {
    request.rate_hz = 0;
    request.request_id += 100;
  }
  static_cast<void>(engines.divide(requests, 2 * kSecond));
  engines.brought("a", 3 * kSecond);
  engines.brought("b", 3 * kSecond);
  engines.update(50 * kSecond);
  engines.brought("a", 50 * kSecond);
  engines.update(60 * kSecond);
  EXPECT_EQ(engines.resting(), 0U);
  // At a rate again, it has as long as at first.
  for (CameraRequest& request : requests) {
    request.rate_hz = 10;
    request.request_id += 100;
  }
  static_cast<void>(engines.divide(requests, 60 * kSecond));
  engines.brought("a", 60 * kSecond);
  engines.update(60 * kSecond + 1);
  EXPECT_EQ(engines.resting(), 0U);
}

TEST(Engines, WhereNobodyBringsAnythingNobodyRestsNorForALightThatHasNoMaps) {
  std::vector<CameraRequest> requests;
  add(requests, CameraRole::Reference, 4);
  Engines engines;
  hear(engines, {{"a", 1}, {"b", 2}});
  EXPECT_EQ(engines.divide(requests, kSecond).size(), 2U);
  engines.update(60 * kSecond);
  EXPECT_EQ(engines.resting(), 0U);
  engines.brought("a", 60 * kSecond);
  engines.brought("b", 60 * kSecond);
  add(requests, CameraRole::Light, 1);
  EXPECT_EQ(engines.divide(requests, 60 * kSecond).size(), 2U);
  engines.update(120 * kSecond);
  EXPECT_EQ(engines.resting(), 0U);
}

}  // namespace
}  // namespace splatbus::capture_bridge::test
