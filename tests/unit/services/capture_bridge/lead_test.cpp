// Which of several bridges writes.
#include "capture-bridge/lead.h"

#include <gtest/gtest.h>

#include "liveness.h"

namespace splatbus::capture_bridge::test {
namespace {

constexpr std::int64_t kMs = 1'000'000;

Node bridge(const std::string& name, std::uint64_t epoch, bool alive = true) {
  return {.name = name, .epoch = epoch, .kind = "capture-bridge", .alive = alive};
}

void hear(Lead& lead, const std::vector<Node>& nodes, std::int64_t now_ns, std::int64_t broker_age_ns = 10'000 * kMs) {
  with_liveness(
      nodes, now_ns, [&](const wire::Liveness& liveness) { lead.take(liveness, now_ns); }, broker_age_ns);
}

TEST(Lead, OneAloneWritesAsSoonAsTheBrokerHearsIt) {
  Lead lead({.since_ns = 5, .name = "a"});
  EXPECT_FALSE(lead.may_write(0));
  hear(lead, {}, kMs);
  EXPECT_FALSE(lead.may_write(kMs));
  hear(lead, {bridge("a", 5), {.name = "b", .epoch = 1}}, 2 * kMs);
  EXPECT_TRUE(lead.may_write(2 * kMs));
  hear(lead, {}, 3 * kMs);
  EXPECT_TRUE(lead.may_write(3 * kMs));
}

TEST(Lead, ABrokerThatWasStartedAgainTakesNobodysPlaceAwayBeforeItHasHeardAll) {
  Lead lead({.since_ns = 5, .name = "a"});
  hear(lead, {bridge("a", 5), bridge("b", 6)}, kMs);
  EXPECT_TRUE(lead.may_write(kMs + Lead::kHandoverNs));
  hear(lead, {bridge("b", 6)}, 300 * kMs, 999 * kMs);
  EXPECT_TRUE(lead.may_write(300 * kMs));
  hear(lead, {bridge("b", 6)}, 301 * kMs, 1000 * kMs);
  EXPECT_FALSE(lead.may_write(301 * kMs));
}

TEST(Lead, WhoIsStartedTogetherWithTheBrokerWaitsForThoseWhoOutlivedBoth) {
  // The broker has been there since 500 ms, and an engine for longer: "b" leads, and has not been heard yet.
  Lead lead({.since_ns = 600 * kMs, .name = "a"});
  const Node engine{.name = "engine", .epoch = 3};
  hear(lead, {bridge("a", 600 * kMs), engine}, 700 * kMs, 200 * kMs);
  EXPECT_FALSE(lead.may_write(700 * kMs));
  EXPECT_EQ(lead.why_not(), "waiting for the broker");
  hear(lead, {bridge("a", 600 * kMs), bridge("b", 4), engine}, 900 * kMs, 400 * kMs);
  EXPECT_FALSE(lead.may_write(900 * kMs));
  hear(lead, {bridge("a", 600 * kMs), bridge("b", 4), engine}, 1500 * kMs, 1000 * kMs);
  EXPECT_FALSE(lead.may_write(1500 * kMs + 2 * Lead::kHandoverNs));
  EXPECT_EQ(lead.leader().name, "b");
  // One that outlived the broker itself may have done so beside another.
  Lead outlived({.since_ns = 5, .name = "a"});
  hear(outlived, {bridge("a", 5)}, 700 * kMs, 200 * kMs);
  EXPECT_FALSE(outlived.may_write(700 * kMs));
  hear(outlived, {bridge("a", 5)}, 1500 * kMs, 1000 * kMs);
  EXPECT_TRUE(outlived.may_write(1500 * kMs));
}

TEST(Lead, OneAloneAtTheStartOfEverythingWaitsForNobody) {
  Lead lead({.since_ns = 600 * kMs, .name = "a"});
  const Node dead{.name = "viewer", .epoch = 3, .alive = false};
  hear(lead, {bridge("a", 600 * kMs), {.name = "engine", .epoch = 550 * kMs}, dead}, 700 * kMs, 200 * kMs);
  EXPECT_TRUE(lead.may_write(700 * kMs));
}

TEST(Lead, SaysWhoLeadsAndNeverThatItWaitsForItself) {
  Lead lead({.since_ns = 5, .name = "a"});
  EXPECT_EQ(lead.why_not(), "waiting for the broker");
  hear(lead, {bridge("a", 5), bridge("b", 4)}, kMs);
  EXPECT_EQ(lead.why_not(), "samples rounds for b, which leads");
  hear(lead, {bridge("a", 5)}, 2 * kMs);
  EXPECT_FALSE(lead.may_write(2 * kMs));
  EXPECT_EQ(lead.why_not(), "about to write: waiting until the broker has told everybody");
}

TEST(Lead, WhatTheBrokerStillSaysOfAProcessBeforeOfItsNameIsNotItsOwn) {
  Lead lead({.since_ns = 9, .name = "a"});
  hear(lead, {bridge("a", 5), bridge("b", 6)}, kMs);
  EXPECT_FALSE(lead.may_write(kMs + 2 * Lead::kHandoverNs));
}

TEST(Lead, TheFirstThatRunsWritesAndWhoComesAgainDoesNotTakeItsPlaceBack) {
  Lead first({.since_ns = 5, .name = "b"}), second({.since_ns = 6, .name = "a"});
  std::int64_t now_ns = 0;
  const auto hear_both = [&](const std::vector<Node>& nodes) {
    hear(first, nodes, now_ns);
    hear(second, nodes, now_ns);
    for (int turn = 0; turn < 3; ++turn) {  // a handover's time
      now_ns += 100 * kMs;
      static_cast<void>(first.may_write(now_ns));
      static_cast<void>(second.may_write(now_ns));
    }
  };
  hear_both({bridge("a", 6), bridge("b", 5)});
  EXPECT_TRUE(first.may_write(now_ns));
  EXPECT_FALSE(second.may_write(now_ns));
  EXPECT_EQ(second.leader().name, "b");
  for (const Node& gone :
       {bridge("b", 5, false),
        Node{.name = "b", .epoch = 5, .kind = "capture-bridge", .state = wire::ServiceState::Standby}}) {
    hear_both({bridge("a", 6), gone});
    EXPECT_TRUE(second.may_write(now_ns));
    EXPECT_FALSE(first.may_write(now_ns));
  }
  // Of the same name, but another process.
  hear_both({bridge("a", 6), bridge("b", 9)});
  EXPECT_TRUE(second.may_write(now_ns));
  EXPECT_FALSE(first.may_write(now_ns));
}

TEST(Lead, WhoComesIntoAnothersPlaceWaitsUntilThatOneHasHeardOfIt) {
  Lead lead({.since_ns = 6, .name = "a"});
  hear(lead, {bridge("a", 6), bridge("b", 5)}, kMs);
  EXPECT_FALSE(lead.may_write(kMs));
  hear(lead, {bridge("a", 6)}, 2 * kMs);
  EXPECT_FALSE(lead.may_write(2 * kMs + Lead::kHandoverNs - 1));
  EXPECT_TRUE(lead.may_write(2 * kMs + Lead::kHandoverNs));
}

TEST(Lead, WhoWasStoppedWritesNothingUntilTheBrokerSaysThatItIsStillTheFirst) {
  Lead lead({.since_ns = 5, .name = "a"});
  hear(lead, {bridge("a", 5)}, kMs);
  EXPECT_TRUE(lead.may_write(kMs));
  const std::int64_t later_ns = 2 * kMs + Lead::kStalledNs;
  EXPECT_FALSE(lead.may_write(later_ns));
  // What the broker said meanwhile is still on its way.
  hear(lead, {bridge("a", 5)}, later_ns - kMs);
  EXPECT_FALSE(lead.may_write(later_ns + kMs));
  EXPECT_TRUE(lead.is_first());
  hear(lead, {bridge("a", 5)}, later_ns + kMs);
  EXPECT_TRUE(lead.may_write(later_ns + 2 * kMs));
}

}  // namespace
}  // namespace splatbus::capture_bridge::test
