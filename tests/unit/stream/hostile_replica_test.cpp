#include <gtest/gtest.h>

#include <map>
#include <numeric>
#include <random>
#include <set>

#include "expectations.h"
#include "stream/bytes.h"
#include "stream/codecs.h"
#include "stream/replica.h"
#include "toy_server.h"

namespace splatbus::stream {
namespace {

using test::expect_exact;
using test::expect_shown;
using test::parse;
using test::send;
using test::ToyServer;

TEST(Hostile, NothingIsHeldBeforeASnapshotAndForeignEpochsAreIgnored) {
  ToyServer server(15);
  test::ShownReplica replica;
  server.train(0.1F);
  send(server.tick(), replica);
  EXPECT_EQ(replica.count(), 0U);
  send(server.stream.snapshot(), replica);
  const PacketWriter writer("other", 1);
  const auto foreign = writer.write(78, replica.held()->sequence + 1, wire::Body::Remove,
                                    [](auto& b) { return wire::CreateRemove(b, 1, 1); });
  EXPECT_FALSE(replica.receive(parse(foreign)));
  expect_exact(server.stream, replica);
}

TEST(Hostile, SnapshotBeginOfImpossibleSizesIsRefused) {
  ToyServer server(16);
  test::ShownReplica replica(1000);
  send(server.stream.snapshot(), replica);
  const PacketWriter writer("streamer", 1);
  const auto begin = [&](std::uint32_t total, std::uint32_t chunks, float step, std::uint8_t degree) {
    return writer.write(77, 0, wire::Body::SnapshotBegin, [&](auto& b) {
      std::vector<flatbuffers::Offset<wire::TensorMetadata>> attributes;
      for (const AttributeChannels& a : server.stream.held().layout.attributes()) {
        const wire::Quantizer quantizer(0, step);
        attributes.push_back(
            wire::CreateTensorMetadata(b, a.attribute, static_cast<std::uint32_t>(a.channels), &quantizer));
      }
      return wire::CreateSnapshotBegin(b, 5, 1, total, chunks,
                                       degree ? wire::Appearance::Radiance : wire::Appearance::Transfer, degree,
                                       b.CreateVector(attributes));
    });
  };
  EXPECT_THROW(replica.receive(parse(begin(1001, 3, 1, 0))), StreamError);
  EXPECT_THROW(replica.receive(parse(begin(0xFFFFFFFFU, 1, 1, 0))), StreamError);
  EXPECT_THROW(replica.receive(parse(begin(100, 101, 1, 0))), StreamError);
  EXPECT_THROW(replica.receive(parse(begin(100, 0, 1, 0))), StreamError);
  EXPECT_THROW(replica.receive(parse(begin(100, 1, 0, 0))), StreamError);
  EXPECT_THROW(replica.receive(parse(begin(100, 1, std::nanf(""), 0))), StreamError);
  EXPECT_THROW(replica.receive(parse(begin(100, 1, 1, 200))), StreamError);
  EXPECT_THROW(replica.receive(parse(begin(100, 1, 1, 2))), StreamError);
  EXPECT_TRUE(replica.needs_snapshot());
  expect_exact(server.stream, replica);
}

class ForgedSnapshot : public testing::Test {
 protected:
  /// Twenty Gaussians are announced; each chunk is a valid one of `count`, said to begin at `first`.
  void begin(std::uint32_t chunks) {
    receive(writer_.write(77, 0, wire::Body::SnapshotBegin, [&](auto& b) {
      std::vector<flatbuffers::Offset<wire::TensorMetadata>> attributes;
      for (const AttributeChannels& a : layout().attributes()) {
        const wire::Quantizer quantizer(a.quantizer.offset, a.quantizer.step);
        attributes.push_back(
            wire::CreateTensorMetadata(b, a.attribute, static_cast<std::uint32_t>(a.channels), &quantizer));
      }
      return wire::CreateSnapshotBegin(b, 9, 1, 20, chunks, wire::Appearance::Transfer, 0, b.CreateVector(attributes));
    }));
  }
  bool chunk(std::uint32_t first, std::uint32_t count) {
    std::vector<std::uint32_t> columns(count);
    std::iota(columns.begin(), columns.end(), first);
    return receive(writer_.write(
        77, 0, wire::Body::Snapshot, [&](auto& b) { return wire::CreateSnapshot(b, 9, 0, first, count); },
        encode_chunk(server_.stream.held().gaussians.gather(columns), layout())));
  }
  bool receive(const EncodedPacket& packet) { return replica_.receive(parse(packet)); }
  const StreamLayout& layout() const { return server_.stream.held().layout; }

  ToyServer server_{19, 300};
  PacketWriter writer_{"streamer", 1};
  test::ShownReplica replica_;
};

TEST_F(ForgedSnapshot, OverlappingChunksWhoseCountsAddUpAreRefused) {
  begin(2);
  chunk(0, 10);
  EXPECT_THROW(chunk(5, 10), StreamError);
  EXPECT_TRUE(replica_.needs_snapshot());
  EXPECT_FALSE(replica_.loading());
  send(server_.stream.snapshot(), replica_);
  expect_exact(server_.stream, replica_);
}

TEST_F(ForgedSnapshot, AGapThatAnOverlapMakesUpForIsRefused) {
  send(server_.stream.snapshot(), replica_);
  begin(3);
  chunk(12, 8);
  chunk(8, 8);
  EXPECT_THROW(chunk(0, 4), StreamError);
  EXPECT_TRUE(replica_.needs_snapshot());
  expect_exact(server_.stream, replica_);  // what was held stays
}

TEST_F(ForgedSnapshot, MoreThanWasAnnouncedIsRefused) {
  begin(2);
  chunk(0, 15);
  EXPECT_THROW(chunk(10, 10), StreamError);
  EXPECT_TRUE(replica_.needs_snapshot());
}

TEST_F(ForgedSnapshot, AChunkTwiceCountsOnce) {
  begin(2);
  EXPECT_TRUE(chunk(0, 10));
  EXPECT_FALSE(chunk(0, 10));
  EXPECT_EQ(replica_.count(), 10U);
  EXPECT_TRUE(chunk(10, 10));
  EXPECT_EQ(replica_.count(), 20U);
  expect_shown(replica_);
}

TEST_F(ForgedSnapshot, WhatIsNoPartOfASnapshotIsNotAppliedToIt) {
  begin(2);
  chunk(0, 10);
  const std::vector<std::uint32_t> slots = {0, 1, 2};
  Payload payload = encode_slots(slots);
  EXPECT_THROW(receive(writer_.write(
                   77, 0, wire::Body::Remove, [&](auto& b) { return wire::CreateRemove(b, 3, payload.raw_bytes); },
                   std::move(payload.bytes))),
               StreamError);
  EXPECT_EQ(replica_.count(), 10U);
}

// Every packet of a history, mutated and truncated in FlatBuffer and payload, against a replica at that very point.
TEST(Hostile, MutatedPacketsThrowOrApplyWithinBoundsAndNeverHalf) {
  ToyServer server(17, 300);
  test::ShownReplica good;
  send(server.stream.snapshot(), good);
  server.scene.objects[3].rigid.translation = {1, 2, 3};
  server.scene.light.generation = 9;
  server.insert(100);
  server.remove(20);
  server.train(0.2F);
  server.model().object_id[5] += 1;
  const auto tick = server.tick();
  std::set<wire::Body> kinds;
  std::mt19937 random(21);
  int thrown = 0, quiet = 0;
  ReplicatedState state = *good.held();
  for (const EncodedPacket& packet : tick) {
    kinds.insert(packet.body);
    for (int round = 0; round < 300; ++round) {
      EncodedPacket mutated = packet;
      Bytes& bytes = mutated.payload.empty() || round % 3 == 0 ? mutated.packet : mutated.payload;
      if (round % 5 == 0) bytes.resize(random() % bytes.size());
      for (int k = 0; k < 2 && !bytes.empty(); ++k)
        bytes[random() % bytes.size()] = static_cast<std::uint8_t>(random());
      ReplicatedState victim = state;
      try {
        const ParsedPacket parsed = parse(mutated);
        try {
          apply(victim, parsed, 5000);
          ++quiet;
          for (const AttributeChannels& a : victim.layout.attributes()) {
            for (int c = 0; c < a.channels; ++c) {
              ASSERT_EQ(victim.gaussians.channels[a.first + c].size(), victim.gaussians.count());
              for (const std::int32_t q : victim.gaussians.channels[a.first + c]) {
                ASSERT_TRUE(q >= a.minimum && q <= a.maximum);
              }
            }
          }
        } catch (const StreamError&) {
          ++thrown;
          ASSERT_TRUE(victim.gaussians == state.gaussians) << "half applied: " << wire::EnumNameBody(packet.body);
        }
      } catch (const StreamError&) {
        ++thrown;
      }
    }
    apply(state, parse(packet));
  }
  EXPECT_TRUE(state.gaussians == server.stream.held().gaussians);
  EXPECT_GT(thrown, 100);
  for (const wire::Body body :
       {wire::Body::Snapshot, wire::Body::TensorDelta, wire::Body::Remove, wire::Body::GaussianOrder,
        wire::Body::ObjectIds, wire::Body::Scene, wire::Body::LightVisibility}) {
    EXPECT_TRUE(kinds.contains(body)) << wire::EnumNameBody(body) << " was not exercised";
  }
}

TEST(Hostile, ReplicaSurvivesMutatedPacketsAndASnapshotHealsIt) {
  ToyServer server(18, 300);
  std::mt19937 random(22);
  for (int round = 0; round < 200; ++round) {
    test::ShownReplica replica(5000);
    EncodedSnapshot snapshot = server.stream.snapshot();
    const auto damage = [&](EncodedPacket& packet) {
      Bytes& bytes = random() % 2 && !packet.payload.empty() ? packet.payload : packet.packet;
      bytes[random() % bytes.size()] ^= static_cast<std::uint8_t>(1 + random() % 255);
    };
    damage(snapshot.head[random() % snapshot.head.size()]);
    damage(snapshot.chunks[random() % snapshot.chunks.size()]);
    for (const auto* part : {&snapshot.head, &snapshot.chunks, &snapshot.tail}) {
      for (const EncodedPacket& packet : *part) {
        try {
          replica.receive(parse(packet));
        } catch (const StreamError&) {
        }
      }
    }
    send(server.stream.snapshot(), replica);
    expect_exact(server.stream, replica);
  }
}

TEST(Hostile, RandomBytesAreNoPackets) {
  std::mt19937 random(23);
  for (int round = 0; round < 2000; ++round) {
    Bytes bytes(random() % 300);
    for (auto& byte : bytes) byte = static_cast<std::uint8_t>(random());
    EXPECT_THROW((void)ParsedPacket::parse(bytes, {}), StreamError);
  }
}

}  // namespace
}  // namespace splatbus::stream
