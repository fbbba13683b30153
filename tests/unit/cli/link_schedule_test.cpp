#include "link_schedule.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "../nanoseconds.h"
#include "network_link.h"

namespace splatbus::cli {
namespace {

TEST(LinkSchedule, WithoutAShapeEverythingIsThereAtOnce) {
  LinkSchedule link({});
  EXPECT_EQ(link.send(1448, 5 * kSecond), 5 * kSecond);
  EXPECT_EQ(link.send(1448, 6 * kSecond), 6 * kSecond);
}

TEST(LinkSchedule, DelayIsHalfOfTheRoundTrip) {
  LinkSchedule link({.round_trip_ms = 100});
  EXPECT_EQ(link.send(1448, kSecond), kSecond + 50 * kMs);
  EXPECT_EQ(link.send(1448, kSecond), kSecond + 50 * kMs) << "they are on the way side by side";
}

TEST(LinkSchedule, RateIsALineThatOneWaitsIn) {
  // 1000 bytes are 8000 bit: 4 ms at 2 Mbit/s.
  LinkSchedule link({.round_trip_ms = 20, .mbps = 2});
  EXPECT_EQ(link.send(1000, kSecond), kSecond + 14 * kMs);
  EXPECT_EQ(link.send(1000, kSecond), kSecond + 18 * kMs) << "behind the first";
  EXPECT_EQ(link.send(1000, kSecond + 6 * kMs), kSecond + 22 * kMs) << "the line is still taken for 2 ms";
  EXPECT_EQ(link.send(1000, 2 * kSecond), 2 * kSecond + 14 * kMs) << "an idle line saves nothing up";
}

TEST(LinkSchedule, IsFullWithAQuarterOfASecondOfTheLineOrAWindow) {
  // 1 Mbit/s: 250 ms are 31,250 bytes.
  LinkSchedule slow({.mbps = 1});
  static_cast<void>(slow.send(31'250, 0));
  EXPECT_FALSE(slow.full(31'250, 0));
  static_cast<void>(slow.send(1, 0));
  EXPECT_TRUE(slow.full(31'251, 0));
  EXPECT_FALSE(slow.full(31'251, kMs)) << "a millisecond later";

  const LinkSchedule far({.round_trip_ms = 1000});
  EXPECT_FALSE(far.full(LinkSchedule::kWindowBytes - 1, 0));
  EXPECT_TRUE(far.full(LinkSchedule::kWindowBytes, 0));
}

TEST(LinkSchedule, WhatIsLostHoldsUpWhatComesBehind) {
  const LinkShape shape{.round_trip_ms = 100, .loss = 0.1};
  constexpr int kSegments = 20000;
  LinkSchedule link(shape, 7);
  int late = 0, later = 0;
  std::int64_t last_ns = 0;
  for (int i = 0; i < kSegments; ++i) {
    // So far apart that nobody waits for another.
    const std::int64_t sent_ns = i * 10 * kSecond;
    const std::int64_t way_ns = link.send(1448, sent_ns) - sent_ns;
    EXPECT_TRUE(way_ns == 50 * kMs || way_ns == 150 * kMs || way_ns >= 450 * kMs) << way_ns;
    late += way_ns > 50 * kMs ? 1 : 0;
    later += way_ns > 150 * kMs ? 1 : 0;
  }
  // A tenth of them: 2000, three standard deviations are 127; of these a tenth again.
  EXPECT_NEAR(late, 2000, 127);
  EXPECT_NEAR(later, 200, 42);

  LinkSchedule dense(shape, 7);
  std::vector<std::int64_t> held_up;
  for (int i = 0; i < 1000; ++i) {
    const std::int64_t sent_ns = i * kMs;
    const std::int64_t there_ns = dense.send(1448, sent_ns);
    EXPECT_GE(there_ns, last_ns) << "in order";
    if (there_ns == last_ns && there_ns != sent_ns + 50 * kMs) held_up.push_back(there_ns - sent_ns);
    last_ns = there_ns;
  }
  EXPECT_GT(held_up.size(), 500U) << "of those within 100 ms behind a loss each waits";
}

TEST(LinkSchedule, NothingLeavesInACutUntilARepetitionPasses) {
  EXPECT_EQ(repeated_until_passed(3 * kSecond, kSecond, {}), 3 * kSecond);
  // Sent at 1 s, repeated after 0.2, 0.4, 0.8, 1.6, 3.2 and 6.4 s more: at 13.6 s it passes.
  const LinkCut cut{.from_ns = kSecond, .to_ns = 11 * kSecond};
  EXPECT_EQ(repeated_until_passed(kSecond, 200 * kMs, cut), 13'600 * kMs);
  EXPECT_EQ(repeated_until_passed(11 * kSecond, 200 * kMs, cut), 11 * kSecond) << "its end is outside";

  LinkSchedule link({.round_trip_ms = 100});
  link.cut(cut);
  EXPECT_EQ(link.send(1448, kSecond - 1), kSecond - 1 + 50 * kMs) << "on the way before it";
  // With the round trip the first timeout is 0.3 s: at 1.3, 1.9, 3.1, 5.5, 10.3, 19.9.
  EXPECT_EQ(link.send(1448, kSecond), 19'900 * kMs + 50 * kMs);
  EXPECT_EQ(link.send(1448, 2 * kSecond), 19'900 * kMs + 50 * kMs) << "behind it, all of them";
  EXPECT_EQ(link.send(1448, 30 * kSecond), 30 * kSecond + 50 * kMs);
}

TEST(LinkShape, SaysWhatItIs) {
  EXPECT_EQ((LinkShape{.round_trip_ms = 100, .mbps = 2.5, .loss = 0.02}.text()),
            "2.5 Mbit/s, 100 ms round trip, 2 % loss");
  EXPECT_EQ(LinkShape{}.text(), "any rate");
}

TEST(NetworkLink, TellsNetemTheSameShape) {
  const LinkShape shape{.round_trip_ms = 100, .mbps = 5, .loss = 0.02};
  const std::vector<std::string> add{"tc",   "qdisc", "add",  "dev",  "lo", "root", "netem", "limit",
                                     "2000", "delay", "50ms", "loss", "2%", "rate", "5mbit"};
  EXPECT_EQ(netem_setup(shape).back(), add);
  // What a change leaves out stays as it was.
  const std::vector<std::string> heal{"tc",    "qdisc", "change", "dev",  "lo", "root",
                                      "netem", "limit", "2000",   "loss", "0%"};
  EXPECT_EQ(netem_command("change", {}, false), heal);
  EXPECT_EQ(netem_command("change", {}, true).back(), "100%");
}

}  // namespace
}  // namespace splatbus::cli
