// What Gaussians see of lights besides the sun, on its way to viewers and on to those who draw.
#include "stream/light_rows.h"

#include <gtest/gtest.h>

#include <map>
#include <numeric>
#include <random>
#include <string>

#include "expectations.h"
#include "shown_replica.h"
#include "stream/codecs.h"
#include "toy_server.h"

namespace splatbus::stream {
namespace {

using test::expect_exact;
using test::expect_shown;
using test::join;
using test::parse;
using test::send;
using test::ShownReplica;
using test::ToyServer;

LightSource point_light(std::uint32_t id, const glm::vec3& position) {
  return {.id = id, .position = position, .intensity = {3, 2, 1}, .range_m = 8};
}

/// A light's visibility, as a function of who and when.
std::uint8_t seen(std::uint64_t gaussian, std::uint32_t light, std::uint64_t version) {
  const std::uint64_t hash = (gaussian * 7919 + light * 104'729 + version / 3 * 31) % 97;
  return static_cast<std::uint8_t>(hash < 40 ? 0 : hash < 80 ? 255 : hash * 2);
}

std::vector<std::uint8_t> rows_of(const GaussiansBuffer& model, const std::vector<std::uint32_t>& ids,
                                  std::uint64_t version) {
  std::vector<std::uint8_t> rows;
  for (const std::uint32_t id : ids) {
    for (std::size_t i = 0; i < model.count(); ++i) rows.push_back(seen(model.gaussian_id[i], id, version));
  }
  return rows;
}

std::vector<std::uint32_t> ids_of(const SceneState& scene) {
  std::vector<std::uint32_t> ids{0};
  for (const LightSource& source : scene.light.sources) ids.push_back(source.id);
  return ids;
}

/// Of every light of the scene, what is drawn is what was said under that version.
void expect_seen(const ToyServer& server, ShownReplica& replica, std::uint64_t version) {
  const GaussiansView view = replica.view();
  const std::vector<std::uint32_t> ids = ids_of(server.scene);
  ASSERT_EQ(view.visibility_u8 != nullptr, ids.size() > 1);
  if (ids.size() == 1) return;
  ASSERT_EQ(view.visibility_rows, ids.size());
  for (std::size_t k = 0; k < ids.size(); ++k) {
    test::for_each_held(server, replica, [&](std::uint64_t id, std::uint32_t row) {
      const int want = seen(id, ids[k], version);
      const int got = view.visibility_u8[k * view.visibility_stride + row];
      ASSERT_LE(std::abs(got - want), want == 0 || want == 255 ? 0 : StreamModel::kMaxVisibilityError)
          << "light " << ids[k] << ", row " << row;
    });
  }
}

TEST(LightRows, FollowLightsAndGaussiansThatComeAndGo) {
  ToyServer server(61, 500);
  ShownReplica replica;
  join(server.stream, replica);
  std::mt19937 random(1);
  auto& sources = server.scene.light.sources;
  for (std::uint64_t round = 1; round <= 60; ++round) {
    if (round % 3 == 0) server.insert(30 + random() % 40);
    if (round % 4 == 0) server.remove(random() % 30);
    if (random() % 3 == 0 && !sources.empty()) sources.erase(sources.begin() + random() % sources.size());
    if (random() % 2 == 0) {
      const std::uint32_t id = 1 + random() % 20;
      const auto at = std::ranges::lower_bound(sources, id, {}, &LightSource::id);
      if (at == sources.end() || at->id != id) sources.insert(at, point_light(id, {0, 2, 0}));
    }
    server.tick_for(replica);
    const std::vector<std::uint32_t> ids = ids_of(server.scene);
    const auto rows = rows_of(server.model(), ids, round);
    send(server.stream.take_visibility(
             {.light_ids = ids, .of_index = rows, .scene_version = server.scene.version + round}),
         replica);
    ASSERT_FALSE(replica.report().urgent());
    EXPECT_TRUE(server.stream.visibility_rests());
    expect_seen(server, replica, round);
    expect_exact(server.stream, replica);
    expect_shown(replica);
    if (round % 10 == 0) {
      ShownReplica late;
      join(server.stream, late, round % 20 == 0 ? kBlockRows : kPageLanes);
      expect_exact(server.stream, late);
      expect_seen(server, late, round);
    }
    if (HasFailure()) return;
  }
}

TEST(LightRows, OfANewGaussianOrLightNothingIsShadowedUntilItIsSaid) {
  ToyServer server(62, 100);
  ShownReplica replica;
  server.scene.light.sources = {point_light(4, {0, 1, 0})};
  (void)server.change_scene();
  join(server.stream, replica);
  const std::vector<std::uint32_t> ids{0, 4};
  const std::vector<std::uint8_t> dark(200, 0);
  send(server.stream.take_visibility({.light_ids = ids, .of_index = dark, .scene_version = 9}), replica);
  server.insert(50);
  ASSERT_TRUE(server.stream.observe(server.model().view()));
  server.stream.make_tick(1e9, {});
  send(test::packets_of(server.stream), replica);
  GaussiansView view = replica.view();
  ASSERT_EQ(view.count, 150U);
  EXPECT_EQ(std::ranges::count(std::span(view.visibility_u8 + view.visibility_stride, 150), 0), 100);
  EXPECT_EQ(std::ranges::count(std::span(view.visibility_u8 + view.visibility_stride, 150), 255), 50);
  server.scene.light.sources.insert(server.scene.light.sources.begin(), point_light(2, {0, 1, 0}));
  send(server.change_scene(), replica);
  view = replica.view();
  ASSERT_EQ(view.visibility_rows, 3U);
  EXPECT_EQ(std::ranges::count(std::span(view.visibility_u8 + view.visibility_stride, 150), 255), 150) << "light 2";
  EXPECT_EQ(std::ranges::count(std::span(view.visibility_u8 + 2 * view.visibility_stride, 150), 0), 100) << "light 4";
  // One that went and came again is another.
  server.scene.light.sources.pop_back();
  send(server.change_scene(), replica);
  server.scene.light.sources.push_back(point_light(4, {0, 1, 0}));
  send(server.change_scene(), replica);
  view = replica.view();
  EXPECT_EQ(std::ranges::count(std::span(view.visibility_u8 + 2 * view.visibility_stride, 150), 255), 150);
}

TEST(LightRows, AreGivenInTheOrderOfAnyLights) {
  ToyServer server(63, 50);
  server.scene.light.sources = {point_light(3, {}), point_light(8, {})};
  (void)server.change_scene();
  const std::vector<std::uint32_t> ids{0, 3, 8};
  const auto rows = rows_of(server.model(), ids, 1);
  (void)server.stream.take_visibility({.light_ids = ids, .of_index = rows, .scene_version = 5});
  Replica replica;
  join(server.stream, replica);
  DisplayGaussians display;
  display.apply(replica.whole());
  const auto row = [](const GaussiansView& view, std::size_t k) {
    return std::vector(view.visibility_u8 + k * view.visibility_stride,
                       view.visibility_u8 + k * view.visibility_stride + 50);
  };
  const GaussiansView own = display.view(server.scene.light.sources);
  const auto sun = row(own, 0), three = row(own, 1), eight = row(own, 2);
  EXPECT_NE(three, eight);
  const GaussiansView other = display.view({point_light(5, {}), point_light(8, {})});
  EXPECT_EQ(other.visibility_rows, 3U);
  EXPECT_EQ(row(other, 0), sun);
  EXPECT_EQ(row(other, 1), std::vector<std::uint8_t>(50, 255));
  EXPECT_EQ(row(other, 2), eight);
  EXPECT_EQ(row(display.view(server.scene.light.sources), 1), three);
}

// Light 1 shines ten times as brightly as light 2, and light 3 is too far away for anybody.
TEST(LightRows, WithinABudgetWhatChangesThePictureMostComesFirstAndAllOfItInTheEnd) {
  ToyServer server(64, 400);
  server.scene.light.sun_irradiance = glm::vec3(0.01F);
  server.scene.light.sources = {point_light(1, {0, 1, 0}), point_light(2, {0, 1, 0}), point_light(3, {500, 1, 0})};
  server.scene.light.sources[0].intensity *= 10;
  (void)server.change_scene();
  ShownReplica replica;
  join(server.stream, replica);
  const std::vector<std::uint32_t> ids{0, 1, 2, 3};
  std::vector<std::uint32_t> order;
  for (std::uint64_t version = 3; version < 40; version += 3) {
    const auto rows = rows_of(server.model(), ids, version);
    for (int step = 0; step < 8; ++step) {
      const auto packets =
          server.stream.take_visibility({.light_ids = ids, .of_index = rows, .scene_version = version}, 1);
      if (packets.empty()) break;
      ASSERT_EQ(packets.size(), 1U);
      order.push_back(parse(packets[0].packet).root().body_as_LightVisibility()->light_id());
      send(packets, replica);
    }
    EXPECT_TRUE(server.stream.visibility_rests());
    expect_seen(server, replica, version);
    if (HasFailure()) return;
  }
  ASSERT_GE(order.size(), 8U);
  EXPECT_EQ(std::vector(order.begin(), order.begin() + 4), (std::vector<std::uint32_t>{1, 2, 0, 3}));
}

// Light 1 changes without end and would take all of the budget.
TEST(LightRows, NoLightWaitsForEver) {
  ToyServer server(65, 400);
  server.scene.light.sources = {point_light(1, {0, 1, 0}), point_light(2, {0, 1, 0})};
  server.scene.light.sources[1].intensity *= 0.2F;
  (void)server.change_scene();
  const std::vector<std::uint32_t> ids{0, 1, 2};
  std::map<std::uint32_t, int> sent;
  for (std::uint64_t version = 3; version < 150; version += 3) {
    const auto rows = rows_of(server.model(), ids, version);
    for (const auto& packet :
         server.stream.take_visibility({.light_ids = ids, .of_index = rows, .scene_version = version}, 1)) {
      ++sent[parse(packet.packet).root().body_as_LightVisibility()->light_id()];
    }
  }
  EXPECT_GT(sent[1], sent[2]);
  EXPECT_GT(sent[2], 3);
}

TEST(LightRows, AreNotThereForGaussiansWhoseLightIsBakedIn) {
  ToyServer server(3, 300, Appearance::Radiance);
  server.scene.light.sources = {point_light(3, {1, 2, 3})};
  ShownReplica replica, late;
  join(server.stream, replica);
  server.tick_for(replica);
  server.train(0.05F);
  server.scene.light.sources.push_back(point_light(4, {0, 1, 0}));
  server.tick_for(replica);
  join(server.stream, late);
  for (ShownReplica* each : {&replica, &late}) {
    ASSERT_EQ(each->scene().light.sources.size(), 2U);
    const GaussiansView shown = each->view();
    EXPECT_EQ(shown.count, 300U);
    EXPECT_EQ(shown.visibility_u8, nullptr);
  }
}

TEST(LightRows, AreRefusedByName) {
  ToyServer server(66, 100);
  server.scene.light.sources = {point_light(7, {})};
  (void)server.change_scene();
  Replica replica;
  join(server.stream, replica);
  const std::vector<std::uint32_t> ids{0, 7};
  const std::vector<std::uint8_t> dark(200, 0);
  EXPECT_THROW((void)server.stream.take_visibility(
                   {.light_ids = ids, .of_index = std::span(dark).first(198), .scene_version = 9}),
               StreamError);
  const PacketWriter writer("streamer", 1);
  const auto refusal = [&](std::uint32_t light, const SlotValues& change, std::uint32_t count) -> std::string {
    Payload payload = encode_slot_values(change);
    ReplicatedState held = replica.held();
    const std::vector<wire::SeenPage> pages{{0, held.find(0)->structure, 100}};
    const auto packet = writer.write(
        77, 0, wire::Body::LightVisibility,
        [&](auto& b) {
          return wire::CreateLightVisibility(b, 9, light, b.CreateVectorOfStructs(pages), count, payload.raw_bytes);
        },
        payload.bytes);
    try {
      apply(held, parse(packet));
    } catch (const StreamError& error) {
      EXPECT_TRUE(held.light_rows == replica.held().light_rows);
      EXPECT_EQ(held.visibility_version, replica.held().visibility_version);
      return error.what();
    }
    return "nothing";
  };
  EXPECT_EQ(refusal(7, {{99}, {3}}, 1), "nothing");
  EXPECT_EQ(refusal(8, {{99}, {3}}, 1), "LightVisibility: of light 8, which the scene does not have");
  EXPECT_EQ(refusal(7, {{100}, {3}}, 1), "LightVisibility: slot 100 of 100 held");
}

// Who has missed some of a page's gets all of it, and nothing that is meant for other lanes.
TEST(LightRows, OfAPageThatIsHeldOtherwiseNothingIsTakenAndAllOfItCanComeAgain) {
  ToyServer server(67, 300);
  server.scene.light.sources = {point_light(7, {})};
  (void)server.change_scene();
  ShownReplica replica;
  join(server.stream, replica);
  server.remove(40);
  const auto removal = server.tick().at(0);
  const std::vector<std::uint32_t> ids{0, 7};
  const auto rows = rows_of(server.model(), ids, 5);
  const auto visibility = server.stream.take_visibility({.light_ids = ids, .of_index = rows, .scene_version = 5});
  const Bytes before = *replica.held().light_rows.find(7);
  send(visibility, replica);
  EXPECT_EQ(*replica.held().light_rows.find(7), before);
  replica.receive(parse(removal));
  send(server.stream.page_visibility(0), replica);
  expect_exact(server.stream, replica);
  expect_seen(server, replica, 5);
}

}  // namespace
}  // namespace splatbus::stream
