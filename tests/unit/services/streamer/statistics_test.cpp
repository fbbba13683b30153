#include <gtest/gtest.h>

#include "../../stream/toy_server.h"
#include "streamer/packet_feed.h"
#include "streamer/wire_statistics.h"

namespace splatbus::streamer {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000;

TEST(WireStatistics, CountsByTypeAndLeavesProbePicturesOutOfTheRates) {
  WireStatistics statistics;
  statistics.begin(5 * kSecond);
  statistics.add(wire::Body::TensorDelta, 100'000);
  statistics.add(wire::Body::TensorDelta, 25'000);
  statistics.add(wire::Body::ProbePicture, 1'000'000);
  auto window = statistics.close_window(6 * kSecond);
  EXPECT_DOUBLE_EQ(window.seconds, 1);
  EXPECT_DOUBLE_EQ(window.mbps, 1);
  EXPECT_EQ(window.bytes, 1'125'000U);
  EXPECT_EQ(window.types[static_cast<std::size_t>(wire::Body::TensorDelta)].packets, 2U);
  window = statistics.close_window(7 * kSecond);
  EXPECT_DOUBLE_EQ(window.mbps, 0);
  EXPECT_DOUBLE_EQ(window.mbps_mean, 0.5);
  EXPECT_DOUBLE_EQ(window.mbps_peak, 1);
  EXPECT_EQ(window.total_bytes, 1'125'000U);
}

TEST(WireStatistics, SaysNothingBeforeTheFirstViewer) {
  WireStatistics statistics;
  EXPECT_DOUBLE_EQ(statistics.close_window(kSecond).mbps_mean, 0);
  statistics.begin(10 * kSecond);
  statistics.begin(20 * kSecond);
  statistics.add(wire::Body::Snapshot, 125'000);
  EXPECT_DOUBLE_EQ(statistics.close_window(11 * kSecond).mbps_mean, 1);
}

TEST(PacketHistory, KeepsTheNewestWithinItsBytes) {
  PacketHistory history(1000);
  EXPECT_FALSE(history.find(1));
  for (std::uint64_t sequence = 5; sequence <= 20; ++sequence) {
    stream::EncodedPacket packet;
    packet.sequence = sequence;
    packet.packet.resize(100);
    history.add(std::make_shared<WirePacket>(packet));
  }
  EXPECT_LE(history.bytes(), 1000U);
  EXPECT_FALSE(history.find(10));
  EXPECT_FALSE(history.find(21));
  for (std::uint64_t sequence = 11; sequence <= 20; ++sequence) {
    ASSERT_TRUE(history.find(sequence));
    EXPECT_EQ(history.find(sequence)->sequence(), sequence);
  }
  history.clear();
  EXPECT_FALSE(history.find(20));
}

TEST(PacketHistory, BeginsAnewAfterAGap) {
  PacketHistory history(1000);
  for (const std::uint64_t sequence : {5U, 6U, 9U, 10U}) {
    stream::EncodedPacket packet;
    packet.sequence = sequence;
    history.add(std::make_shared<WirePacket>(packet));
  }
  for (const std::uint64_t lost : {5U, 6U, 7U, 8U}) EXPECT_FALSE(history.find(lost)) << lost;
  for (const std::uint64_t kept : {9U, 10U}) {
    ASSERT_TRUE(history.find(kept));
    EXPECT_EQ(history.find(kept)->sequence(), kept);
  }
}

TEST(PacketFeed, WhatWasNotSentYetIsNotResentButSentInItsTurn) {
  stream::test::ToyServer server(3, 200);
  PacketFeed feed(server.stream, 1 << 24);
  StreamCursor cursor;
  const std::uint64_t held = server.stream.held().sequence;
  ASSERT_TRUE(feed.resume(cursor, server.stream.held().epoch, held));
  for (int tick = 0; tick < 4; ++tick) {
    server.train(0.1F);
    feed.add(server.tick());
  }
  const std::uint64_t last = server.stream.held().sequence;
  ASSERT_GT(last, held + 6);
  bool lagged = false;
  const auto next = [&]() -> std::uint64_t {
    const SharedPacket packet = feed.next(cursor, std::nullopt, kSecond, true, lagged);
    if (!packet) return 0;
    PacketFeed::advance(cursor);
    return packet->sequence();
  };
  for (std::uint64_t sequence = held + 1; sequence <= held + 4; ++sequence) ASSERT_EQ(next(), sequence);
  feed.resend(cursor, held + 2, ~std::uint64_t{0});
  for (std::uint64_t sequence = held + 2; sequence <= last; ++sequence) ASSERT_EQ(next(), sequence);
  EXPECT_EQ(next(), 0U);
  feed.resend(cursor, held + 3, held + 3);
  EXPECT_EQ(next(), held + 3);
  EXPECT_EQ(next(), 0U);
  EXPECT_FALSE(lagged);
  EXPECT_EQ(feed.snapshots(), 0U);
}

}  // namespace
}  // namespace splatbus::streamer
