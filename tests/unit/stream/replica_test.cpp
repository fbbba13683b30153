#include "stream/replica.h"

#include <gtest/gtest.h>

#include <map>
#include <numeric>
#include <random>
#include <set>

#include "expectations.h"
#include "shown_replica.h"
#include "stream/bytes.h"
#include "stream/codecs.h"
#include "toy_server.h"

namespace splatbus::stream {
namespace {

using test::expect_exact;
using test::expect_shown;
using test::parse;
using test::send;
using test::ToyServer;

TEST(ClosedLoop, MirrorAndReplicaAgreeBitForBitAfterRandomHistories) {
  for (std::uint32_t seed = 1; seed <= 6; ++seed) {
    std::mt19937 random(seed);
    ToyServer server(seed, 500, seed % 2 ? Appearance::Transfer : Appearance::Radiance);
    test::ShownReplica replica;
    send(server.stream.snapshot(), replica);
    for (int tick = 0; tick < 40; ++tick) {
      switch (random() % 5) {
        case 0:
          server.insert(random() % 400);
          break;
        case 1:
          server.remove(random() % 60);
          break;
        case 2:
          server.scene.light.sun_irradiance.x += 1, ++server.scene.light.generation;
          break;
        case 3:
          server.scene.objects[random() % 3].rigid.translation.y += 0.1F;
          break;
        default:
          break;
      }
      server.train(0.02F);
      send(server.tick(random() % 3 ? 3000 : 1e9), replica);
      ASSERT_FALSE(replica.missing());
      ASSERT_FALSE(replica.needs_snapshot());
    }
    expect_exact(server.stream, replica);
    expect_shown(replica);
    EXPECT_EQ(replica.scene().light.sun_irradiance, server.scene.light.sun_irradiance);
    EXPECT_EQ(replica.scene().objects.size(), server.scene.objects.size());
    test::ShownReplica late;
    send(server.stream.snapshot(), late);
    expect_exact(server.stream, late);
  }
}

TEST(ClosedLoop, EveryGaussianKeepsItsIdAndObject) {
  ToyServer server(4);
  test::ShownReplica replica;
  send(server.stream.snapshot(), replica);
  server.insert(300);
  server.remove(100);
  server.train(0.01F);
  for (int tick = 0; tick < 3; ++tick) send(server.tick(), replica);
  std::map<std::uint64_t, std::uint32_t> object_of;
  for (std::size_t i = 0; i < server.model().count(); ++i) {
    object_of[server.model().gaussian_id[i]] = server.model().object_id[i];
  }
  const QuantizedGaussians& held = replica.held()->gaussians;
  ASSERT_EQ(held.count(), object_of.size());
  for (std::size_t i = 0; i < held.count(); ++i) {
    ASSERT_TRUE(object_of.contains(held.gaussian_id[i]));
    EXPECT_EQ(object_of[held.gaussian_id[i]], held.object_id[i]);
  }
}

TEST(Loss, ResendOfWhatIsMissingHeals) {
  ToyServer server(9);
  test::ShownReplica replica;
  send(server.stream.snapshot(), replica);
  std::map<std::uint64_t, EncodedPacket> history;
  std::mt19937 random(3);
  int lost = 0;
  for (int tick = 0; tick < 20; ++tick) {
    server.insert(20);
    server.remove(5);
    server.train(0.05F);
    for (const EncodedPacket& packet : server.tick()) {
      history[packet.sequence] = packet;
      if (random() % 3 == 0) {
        ++lost;
      } else {
        replica.receive(parse(packet));
      }
    }
  }
  ASSERT_GT(lost, 10);
  int asked = 0;
  for (auto gap = replica.missing(); gap; gap = replica.missing()) {
    ASSERT_LE(gap->first, gap->last);
    ASSERT_LT(asked++, 1000);
    for (std::uint64_t s = gap->first; s <= gap->last; ++s) replica.receive(parse(history.at(s)));
  }
  // A loss at the very end shows only in an Keepalive.
  const PacketWriter writer("streamer", 1);
  replica.receive(parse(writer.write(77, 0, wire::Body::Keepalive, [&](auto& b) {
    return wire::CreateKeepalive(b, server.stream.held().sequence, 0, 1);
  })));
  for (auto gap = replica.missing(); gap; gap = replica.missing()) {
    for (std::uint64_t s = gap->first; s <= gap->last; ++s) replica.receive(parse(history.at(s)));
  }
  expect_exact(server.stream, replica);
  expect_shown(replica);
}

TEST(Loss, PacketsTwiceAndInAnyOrderChangeNothing) {
  ToyServer server(10);
  test::ShownReplica replica;
  send(server.stream.snapshot(), replica);
  std::vector<EncodedPacket> packets;
  for (int tick = 0; tick < 10; ++tick) {
    server.insert(10);
    server.train(0.05F);
    for (EncodedPacket& packet : server.tick()) packets.push_back(packet), packets.push_back(packets.back());
  }
  std::mt19937 random(5);
  std::ranges::shuffle(packets, random);
  send(packets, replica);
  expect_exact(server.stream, replica);
}

TEST(Loss, WhatIsMissingEndsWhereTheNextPacketIsHeld) {
  ToyServer server(26);
  test::ShownReplica replica;
  send(server.stream.snapshot(), replica);
  const std::uint64_t first = replica.held()->sequence + 1;
  std::vector<EncodedPacket> packets;
  while (packets.size() < 7) {
    server.train(0.1F);
    for (EncodedPacket& packet : server.tick()) packets.push_back(std::move(packet));
  }
  for (const std::size_t arrives : {0U, 3U, 4U, 6U}) replica.receive(parse(packets[arrives]));
  EXPECT_EQ(replica.missing(), (MissingPackets{first + 1, first + 2}));
  for (const std::size_t arrives : {1U, 2U}) replica.receive(parse(packets[arrives]));
  EXPECT_EQ(replica.missing(), (MissingPackets{first + 5, first + 5}));
}

TEST(Loss, AfterAPacketThatWasCutASnapshotIsFollowedOn) {
  ToyServer server(27);
  test::ShownReplica replica;
  send(server.stream.snapshot(), replica);
  const std::uint64_t before = replica.held()->sequence;
  server.train(0.1F);
  EncodedPacket cut = server.tick().front();
  ASSERT_FALSE(cut.payload.empty());
  cut.payload.resize(cut.payload.size() / 2);
  EXPECT_THROW(replica.receive(parse(cut)), StreamError);
  EXPECT_TRUE(replica.needs_snapshot());
  EXPECT_FALSE(replica.refusal().empty());
  EXPECT_FALSE(replica.missing());
  server.train(0.1F);
  send(server.tick(), replica);
  EXPECT_EQ(replica.held()->sequence, before) << "what was cut is not skipped";
  send(server.stream.snapshot(), replica);
  EXPECT_FALSE(replica.needs_snapshot());
  server.train(0.1F);
  send(server.tick(), replica);
  expect_exact(server.stream, replica);
  expect_shown(replica);
}

TEST(Loss, NothingOfAnEpochIsWaitedForOrAppliedInTheNext) {
  ToyServer old(28);
  test::ShownReplica replica;
  send(old.stream.snapshot(), replica);
  for (int tick = 0; tick < 4; ++tick) {
    old.train(0.1F);
    const auto packets = old.tick();
    send({packets.begin() + 1, packets.end()}, replica);  // these wait for the first
  }
  ASSERT_TRUE(replica.missing());
  // Its numbers follow on where the old ones wait.
  ToyServer restarted(29, 300, Appearance::Transfer, {.chunk_gaussians = 256}, 78);
  while (restarted.stream.held().sequence < replica.missing()->last) restarted.stream.reset_to_target();
  send(restarted.stream.snapshot(), replica);
  EXPECT_FALSE(replica.missing());
  expect_exact(restarted.stream, replica);
  EXPECT_EQ(replica.epoch(), 78U);
}

TEST(Snapshot, FirstChunkIsShownAtOnceAndInAnyOrderTheWholeIsExact) {
  ToyServer server(11, 1500);
  EncodedSnapshot snapshot = server.stream.snapshot();
  ASSERT_GE(snapshot.chunks.size(), 5U);
  std::ranges::reverse(snapshot.chunks);
  test::ShownReplica replica;
  send(snapshot.head, replica);
  EXPECT_EQ(replica.count(), 0U);
  EXPECT_TRUE(replica.receive(parse(snapshot.chunks[0])));
  EXPECT_GT(replica.count(), 0U);
  EXPECT_TRUE(replica.loading());
  // Broadcast packets wait for the rest.
  server.train(0.05F);
  const auto packets = server.tick();
  send(packets, replica);
  EXPECT_TRUE(replica.loading());
  for (const EncodedPacket& packet : snapshot.chunks) replica.receive(parse(packet));
  send(snapshot.tail, replica);
  EXPECT_FALSE(replica.loading());
  expect_exact(server.stream, replica);
}

// The streamer keeps a snapshot for a while: the viewer may hold early packets that are newer.
TEST(Snapshot, WhatWasBroadcastSinceWaitsForItsIds) {
  ToyServer server(24);
  test::ShownReplica replica;
  send(server.stream.snapshot(), replica);
  const EncodedSnapshot cached = server.stream.snapshot();
  server.remove(60);
  server.insert(40);
  server.train(0.05F);
  const auto packets = server.tick();
  ASSERT_TRUE(std::ranges::any_of(packets, [](const auto& packet) { return packet.body == wire::Body::Remove; }));
  const auto halfway = cached.tail.begin() + 1;
  send(cached.head, replica);
  send(packets, replica);  // early
  send(cached.chunks, replica);
  EXPECT_EQ(replica.count(), 600U);
  EXPECT_TRUE(replica.loading());
  EXPECT_FALSE(replica.missing());
  send({cached.tail.begin(), halfway}, replica);
  EXPECT_EQ(replica.count(), 600U);
  send({halfway, cached.tail.end()}, replica);
  EXPECT_FALSE(replica.loading());
  expect_exact(server.stream, replica);
  expect_shown(replica);
}

TEST(Snapshot, OldPictureStaysUntilTheNewOneIsWhole) {
  ToyServer first(12, 700), second(13, 900);
  test::ShownReplica replica;
  send(first.stream.snapshot(), replica);
  const EncodedSnapshot snapshot = second.stream.snapshot();
  send(snapshot.head, replica);
  for (std::size_t i = 0; i + 1 < snapshot.chunks.size(); ++i) {
    EXPECT_FALSE(replica.receive(parse(snapshot.chunks[i])));
    EXPECT_EQ(replica.count(), 700U);
  }
  EXPECT_TRUE(replica.receive(parse(snapshot.chunks.back())));
  EXPECT_EQ(replica.count(), 900U);
}

TEST(Snapshot, JumpIsNoticedByWhoeverHeldSomething) {
  ToyServer server(14);
  test::ShownReplica replica;
  send(server.stream.snapshot(), replica);
  server.stream.reset_to_target();
  server.train(0.1F);
  send(server.tick(), replica);
  ASSERT_TRUE(replica.missing());
  EXPECT_EQ(replica.missing()->first, replica.held()->sequence + 1);
}

}  // namespace
}  // namespace splatbus::stream
