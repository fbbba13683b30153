#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <string>

#include "expectations.h"
#include "stream/bytes.h"
#include "stream/codecs.h"
#include "stream/replica.h"
#include "toy_server.h"

namespace splatbus::stream {
namespace {

using test::expect_exact;
using test::expect_shown;
using test::join;
using test::parse;
using test::send;
using test::ToyServer;

/// Two replicas' worth of everything that apply() may touch.
bool same(const ReplicatedState& a, const ReplicatedState& b) {
  const auto pages = [](const ReplicatedState& state) {
    std::vector<std::tuple<std::uint32_t, std::uint32_t, std::uint32_t, std::uint32_t>> out;
    for (const auto& [number, page] : state.pages) out.emplace_back(number, page.version, page.count, page.missing);
    return out;
  };
  return a.gaussians == b.gaussians && pages(a) == pages(b) && a.free_blocks == b.free_blocks && a.count == b.count &&
         a.light_rows == b.light_rows && a.quantized_scene == b.quantized_scene &&
         a.visibility_version == b.visibility_version;
}

class Hostile : public testing::Test {
 protected:
  Hostile() { join(server_.stream, replica_); }

  /// Why a packet is refused; the state is then as it was.
  std::string refusal(const EncodedPacket& packet) {
    ReplicatedState state = replica_.held();
    try {
      apply(state, parse(packet));
    } catch (const StreamError& error) {
      EXPECT_TRUE(same(state, replica_.held())) << error.what();
      return error.what();
    }
    return "nothing";
  }
  void expect_refused(const std::string& word, const EncodedPacket& packet) {
    const std::string why = refusal(packet);
    EXPECT_NE(why.find(word), std::string::npos) << why << " for " << word;
  }

  struct PageFields {
    std::uint32_t page = 0, version = 1000, structure = 1000, count = 300, first = 0, part = 300;
    std::uint8_t codec = 0;
    std::uint32_t blob_bytes = 0, more = 0;
  };
  EncodedPacket page(const PageFields& f, const std::vector<wire::SeenRow>& seen = {}, const Bytes& rows = {}) {
    std::vector<std::uint32_t> lanes(300);
    for (std::uint32_t i = 0; i < 300; ++i) lanes[i] = replica_.held().find(0)->row(i);
    Bytes payload =
        encode_page(replica_.held().gaussians.gather(lanes), replica_.held().layout, PageCodec::Draco).bytes;
    const auto blob = static_cast<std::uint32_t>(payload.size()) + f.blob_bytes;
    payload.insert(payload.end(), rows.begin(), rows.end());
    payload.resize(payload.size() + f.more);
    return writer_.write(
        77, 0, wire::Body::Page,
        [&](auto& b) {
          return wire::CreatePage(b, f.page, f.version, f.structure, f.count, f.first, f.part, 0, false, f.codec, blob,
                                  b.CreateVectorOfStructs(seen));
        },
        std::move(payload));
  }

  EncodedPacket delta(const std::vector<wire::PageStep>& steps, const wire::Section& removed, const Payload& slots = {},
                      const std::vector<wire::ValueSection>& values = {}, const Payload& residuals = {}) {
    Bytes payload = slots.bytes;
    payload.insert(payload.end(), residuals.bytes.begin(), residuals.bytes.end());
    return writer_.write(
        77, 0, wire::Body::PageDelta,
        [&](auto& b) {
          return wire::CreatePageDelta(b, b.CreateVectorOfStructs(steps), 0, &removed, 0, nullptr, nullptr,
                                       b.CreateVectorOfStructs(values));
        },
        std::move(payload));
  }
  [[nodiscard]] std::uint32_t version() const { return replica_.held().find(0)->version; }
  [[nodiscard]] wire::PageStep step(std::uint32_t removed = 0, std::uint32_t appended = 0) const {
    return {0, 0, version(), version() + 1, 600, removed, appended};
  }

  ToyServer server_{15};
  test::ShownReplica replica_;
  PacketWriter writer_{"streamer", 1};
};

TEST_F(Hostile, NothingIsHeldBeforeALayoutAndForeignEpochsAreIgnored) {
  test::ShownReplica fresh;
  server_.train(0.1F);
  send(server_.tick(), fresh);
  test::send_pages(server_.stream, fresh);
  EXPECT_EQ(fresh.count(), 0U);
  const ReplicatedState before = replica_.held();
  const auto foreign = writer_.write(78, 0, wire::Body::PagesGone, [](auto& b) {
    return wire::CreatePagesGone(b, b.CreateVector(std::vector<std::uint32_t>{0}));
  });
  EXPECT_FALSE(replica_.receive(parse(foreign)));
  EXPECT_TRUE(same(replica_.held(), before));
}

TEST_F(Hostile, ALayoutThatMakesNoSenseIsRefused) {
  const auto layout = [&](float step, std::uint8_t degree, std::uint32_t lanes) {
    return writer_.write(79, 0, wire::Body::Layout, [&](auto& b) {
      std::vector<flatbuffers::Offset<wire::TensorMetadata>> attributes;
      for (const AttributeChannels& a : server_.stream.held().layout.attributes()) {
        const wire::Quantizer quantizer(0, step);
        attributes.push_back(
            wire::CreateTensorMetadata(b, a.attribute, static_cast<std::uint32_t>(a.channels), &quantizer));
      }
      return wire::CreateLayout(b, degree ? wire::Appearance::Radiance : wire::Appearance::Transfer, degree,
                                b.CreateVector(attributes), lanes);
    });
  };
  const ReplicatedState before = replica_.held();
  EXPECT_THROW(replica_.receive(parse(layout(0, 0, kPageLanes))), StreamError);
  EXPECT_THROW(replica_.receive(parse(layout(std::nanf(""), 0, kPageLanes))), StreamError);
  EXPECT_THROW(replica_.receive(parse(layout(1, 200, kPageLanes))), StreamError);
  EXPECT_THROW(replica_.receive(parse(layout(1, 2, kPageLanes))), StreamError);
  EXPECT_THROW(replica_.receive(parse(layout(1, 0, 1 << 20))), StreamError);
  EXPECT_TRUE(same(replica_.held(), before));
  EXPECT_EQ(replica_.epoch(), 77U);
}

TEST_F(Hostile, PagesAreRefusedByName) {
  EXPECT_EQ(refusal(page({})), "nothing");
  expect_refused("Page: 1048576", page({.page = 1U << 20}));
  expect_refused("version 0", page({.version = 0, .structure = 0}));
  expect_refused("structure 1001", page({.structure = 1001}));
  expect_refused("of 1025", page({.count = 1025}));
  expect_refused("lanes 0 + 300 of 299", page({.count = 299}));
  expect_refused("lanes 100 + 300", page({.count = 400, .first = 100}));
  expect_refused("lanes 256 + 4294967295", page({.first = 256, .part = 0xFFFFFFFFU}));
  expect_refused("lanes 0 + 0", page({.part = 0}));
  expect_refused("codec 9", page({.codec = 9}));
  expect_refused("a part of", page({.blob_bytes = 1}));
  expect_refused("1 bytes behind", page({.more = 1}));
  expect_refused("differs from the one that is held", page({.version = version(), .structure = version()}));
  const Bytes row = zstd_compress(Bytes(300, 9));
  const auto bytes = static_cast<std::uint32_t>(row.size());
  EXPECT_EQ(refusal(page({}, {{0, 300, bytes}}, row)), "nothing");
  expect_refused("299 values of light 0", page({}, {{0, 299, bytes}}, row));
  Bytes two = row;
  two.insert(two.end(), row.begin(), row.end());
  expect_refused("values of light 3", page({}, {{3, 300, bytes}, {3, 300, bytes}}, two));
  expect_refused("a part of", page({}, {{0, 300, bytes + 1}}, row));
}

TEST_F(Hostile, DeltasAreRefusedByName) {
  const Payload slots = encode_slots(std::vector<std::uint32_t>{3, 599});
  const auto size = [](const Payload& p) { return static_cast<std::uint32_t>(p.bytes.size()); };
  const wire::Section two(2, slots.raw_bytes, size(slots));
  EXPECT_EQ(refusal(delta({step(2)}, two, slots)), "nothing");
  expect_refused("2 removed where the steps have 0", delta({step()}, two, slots));
  expect_refused("less 601", delta({step(601)}, {601, 0, 0}));
  expect_refused("and 1025", delta({step(0, 1025)}, {}));
  expect_refused("twice", delta({step(), step()}, {}));
  expect_refused("600 are held", delta({{0, 0, version(), version() + 1, 599, 0, 0}}, {}));
  expect_refused("at version", delta({{0, 0, version(), version(), 600, 0, 0}}, {}));
  expect_refused("is new, and a base", delta({{1, 0, version(), version() + 1, 600, 0, 0}, {2, 1, 1, 2, 5, 0, 0}}, {}));
  expect_refused("1 appended where", writer_.write(77, 0, wire::Body::PageDelta, [&](auto& b) {
    const std::vector<wire::PageStep> steps{step()};
    const wire::Section appended(1, 0, 0);
    return wire::CreatePageDelta(b, b.CreateVectorOfStructs(steps), 0, nullptr, 0, &appended);
  }));
  const Payload beyond = encode_slots(std::vector<std::uint32_t>{3, 600});
  expect_refused("slot 600 of 600", delta({step(2)}, {2, beyond.raw_bytes, size(beyond)}, beyond));

  const auto values = [&](Attribute attribute, const Delta& d, std::uint32_t count) {
    const Payload p = encode_delta(d);
    return delta({step()}, {}, {}, {{attribute, count, p.raw_bytes, size(p)}}, p);
  };
  const Delta red{{5}, {{1}, {0}, {0}}};
  EXPECT_EQ(refusal(values(Attribute::Albedo, red, 1)), "nothing");
  expect_refused("not in this stream", values(Attribute::ShDc, red, 1));
  expect_refused("PageDelta's values", values(Attribute::Albedo, red, 2));
  expect_refused("PageDelta's values", values(Attribute::Opacity, red, 1));
  expect_refused("slot 600", values(Attribute::Albedo, {{600}, {{1}, {0}, {0}}}, 1));
  expect_refused("Albedo of lane 5", values(Attribute::Albedo, {{5}, {{1}, {1 << 15}, {0}}}, 1));
  // Where the page is held otherwise nothing of it is looked at, and it is named.
  const Payload wild = encode_delta({{5}, {{1}, {1 << 15}, {0}}});
  const Change change = [&] {
    ReplicatedState state = replica_.held();
    const auto packet = delta({{0, 0, version() + 7, version() + 8, 600, 0, 0}}, {}, {},
                              {{Attribute::Albedo, 1, wild.raw_bytes, size(wild)}}, wild);
    Change out = apply(state, parse(packet));
    EXPECT_TRUE(same(state, replica_.held()));
    return out;
  }();
  EXPECT_EQ(change.lacks, std::vector<std::uint32_t>{0});
}

TEST_F(Hostile, ManySmallPagesTakeNoMoreRowsThanTheBoundAllows) {
  Replica small(2000);
  small.receive(parse(server_.stream.layout_packet()));
  QuantizedGaussians one =
      replica_.held().gaussians.gather(std::vector<std::uint32_t>{replica_.held().find(0)->row(0)});
  const Bytes blob = encode_page(one, replica_.held().layout, PageCodec::Draco).bytes;
  for (std::uint32_t number = 0; number < 1500; ++number) {
    small.receive(parse(writer_.write(
        77, 0, wire::Body::Page,
        [&](auto& b) {
          return wire::CreatePage(b, number, 5, 5, 1, 0, 1, 0, false, 0, static_cast<std::uint32_t>(blob.size()));
        },
        blob)));
  }
  EXPECT_LE(small.held().rows(), std::size_t{2} * 2000 + 2 * 256 * kBlockRows);
  EXPECT_FALSE(small.report().dropped.empty());
}

// Every byte of real packets changed at random: refused or taken, never half of it, and what is taken can be shown.
TEST_F(Hostile, MutatedPacketsNeverLeaveAStateThatIsHalfChanged) {
  server_.insert(200);
  server_.remove(50);
  server_.train(0.03F);
  std::vector<EncodedPacket> packets = server_.tick();
  packets.push_back(server_.stream.page_packets(0)[0].packet);
  std::mt19937 random(5);
  std::size_t refused = 0, taken = 0;
  for (int round = 0; round < 400; ++round) {
    EncodedPacket packet = packets[random() % packets.size()];
    Bytes& bytes = random() % 3 == 0 && !packet.payload.empty() ? packet.payload : packet.packet;
    for (int k = 0; k < 1 + static_cast<int>(random() % 3); ++k) {
      bytes[random() % bytes.size()] ^= static_cast<std::uint8_t>(1U << random() % 8);
    }
    ReplicatedState state = replica_.held();
    try {
      apply(state, ParsedPacket::parse(packet.packet, packet.payload));
      ++taken;
    } catch (const StreamError&) {
      ++refused;
      ASSERT_TRUE(same(state, replica_.held()));
    }
  }
  EXPECT_GT(refused, 100U);
  EXPECT_GT(taken, 10U);
}

TEST(HostilePacket, GarbageIsRefused) {
  std::mt19937 random(8);
  EXPECT_THROW((void)ParsedPacket::parse({}, {}), StreamError);
  for (int round = 0; round < 2000; ++round) {
    Bytes bytes(random() % 300);
    for (auto& byte : bytes) byte = static_cast<std::uint8_t>(random());
    EXPECT_THROW((void)ParsedPacket::parse(bytes, {}), StreamError);
  }
}

}  // namespace
}  // namespace splatbus::stream
