// What the broker holds, and for whom it inlines, seen by publishers that say what they like about themselves.
#include <gtest/gtest.h>

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "../../hostile/raw_zmtp.h"
#include "../nanoseconds.h"
#include "bus/clock.h"
#include "bus/latch_store.h"
#include "bus_fixture.h"
#include "fake_broker.h"
#include "slab_helpers.h"

namespace splatbus::bus_test {
namespace {

struct Claim {
  std::string source = "a";
  std::uint64_t sequence = 1;
  std::uint64_t epoch = 1;
  std::int64_t publish_ns = 0;
};

class Relay : public BusTest {
 protected:
  Relay()
      : witness_(connect("witness"), {"grid/state", "viewer/probe"}), raw_(directory_.address().publish_endpoint()) {
    EXPECT_TRUE(witness_.wait_connected(patience));
  }

  void send(const std::string& topic, const Claim& claim, std::uint64_t number, bool latch) {
    flatbuffers::FlatBufferBuilder builder;
    builder.ForceDefaults(true);
    const auto header = wire::CreateHeaderDirect(builder, "ViewerProbe/1", claim.source.c_str(), claim.sequence,
                                                 claim.epoch, 0, claim.publish_ns, 0, latch, "key");
    const wire::Camera camera;
    builder.Finish(wire::CreateViewerProbe(builder, header, number, &camera));
    raw_.send({topic, {reinterpret_cast<const char*>(builder.GetBufferPointer()), builder.GetSize()}});
  }

  /// Sends latched messages numbered from 1, and says which came through, and which the broker holds at the end.
  void expect_held(const std::vector<Claim>& claims, const std::vector<std::uint64_t>& relayed, std::uint64_t held) {
    for (std::size_t i = 0; i < claims.size(); ++i) send("grid/state", claims[i], i + 1, true);
    send("viewer/probe", {}, 99, false);
    std::vector<std::uint64_t> came;
    for (auto number = receive_number(witness_); number && *number != 99; number = receive_number(witness_)) {
      came.push_back(*number);
    }
    EXPECT_EQ(came, relayed);
    bus::Subscriber late(connect("late"), {"grid/state"});
    const auto message = late.receive(patience);
    ASSERT_TRUE(message.has_value());
    EXPECT_EQ(number_of(*message), held);
    EXPECT_TRUE(message->header().resent());
  }

  bus::Subscriber witness_;
  RawPublisher raw_;
};

TEST_F(Relay, TheLaterStampOfTwoSourcesIsHeld) {
  const std::int64_t now = bus::now_ns();
  expect_held({{.source = "a", .publish_ns = now - 1 * kSecond},
               {.source = "b", .publish_ns = now - 2 * kSecond},
               {.source = "c", .publish_ns = now - kSecond / 2}},
              {1, 3}, 3);
}

TEST_F(Relay, ALowerSequenceOfASourceIsARepeat) {
  expect_held({{.sequence = 1}, {.sequence = 3}, {.sequence = 2}, {.sequence = 3}, {.sequence = 1}}, {1, 2}, 2);
}

TEST_F(Relay, AnEarlierStartOfASourceIsNotHeard) {
  expect_held({{.sequence = 5, .epoch = 2}, {.sequence = 9, .epoch = 1}, {.sequence = 1, .epoch = 3}}, {1, 3}, 3);
}

TEST_F(Relay, AClockThatIsAheadKeepsNobodyOut) {
  const std::int64_t now = bus::now_ns();
  expect_held(
      {{.source = "a", .publish_ns = now + 3600 * kSecond}, {.source = "b", .publish_ns = now + 1800 * kSecond}},
      {1, 2}, 2);
}

/// The broker marks what it holds, in place. Here the mark's place is another one, up to those that say where the rest
/// of the message is.
TEST_F(Relay, AMessageWhoseFieldsOverlapIsNotHeld) {
  for (int place = 0; place < 48; ++place) {
    flatbuffers::FlatBufferBuilder builder;
    builder.ForceDefaults(true);
    const auto offset = wire::CreateHeaderDirect(builder, "ViewerProbe/1", "a", 1, 1, 0, 0, 0, true,
                                                 ("key-" + std::to_string(place)).c_str());
    const wire::Camera camera;
    builder.Finish(wire::CreateViewerProbe(builder, offset, 1, &camera));
    std::string body(reinterpret_cast<const char*>(builder.GetBufferPointer()), builder.GetSize());
    auto* header = flatbuffers::GetMutableRoot<wire::Envelope>(body.data())->mutable_header();
    auto* table = reinterpret_cast<std::uint8_t*>(header);
    std::uint8_t* const vtable = table - flatbuffers::ReadScalar<flatbuffers::soffset_t>(table);
    flatbuffers::WriteScalar(vtable + wire::Header::VT_RESENT, static_cast<flatbuffers::voffset_t>(place));
    // The second one is compared with what is held of the first.
    for (int i = 0; i < 2; ++i) raw_.send({"grid/state", body});
  }
  send("viewer/probe", {.source = "b"}, 99, false);
  std::optional<std::uint64_t> number;
  while ((number = receive_number(witness_)) && *number != 99) {
  }
  EXPECT_EQ(number, 99u) << "the broker goes on";
  EXPECT_GT(broker_->statistics().malformed, 0u);
}

/// Where two messages of `kLarge` have no room at once, which is more than a kernel takes of one.
class SmallRelay : public BusTest {
 protected:
  static constexpr std::size_t kLarge = std::size_t{24} << 20;

  SmallRelay() {
    broker_.reset();
    auto bounded = options();
    bounded.max_remote_bytes = kLarge + kLarge / 2;
    broker_ = std::make_unique<bus_service::Broker>(bounded);
    broker_->start();
    raw_.emplace(directory_.address().publish_endpoint());
    raw_->send({"grid/state", probe_body(1, 7, {}, "ViewerProbe/1", true, "key"), std::string(kLarge, 'x')});
  }

  /// Comes while another reader has not taken it yet, and gets it when that has.
  void expect_to_come_late(const std::string& endpoint, const std::function<std::shared_ptr<bus::Context>()>& connect) {
    hostile::RawZmtp slow(endpoint);
    ASSERT_TRUE(slow.handshake("SUB"));
    ASSERT_TRUE(slow.send_frame("\x01grid/state", false));
    ASSERT_FALSE(slow.read_some(1, patience).empty());
    const std::uint64_t dropped = broker_->statistics().inline_dropped;
    bus::Subscriber late(connect(), {"grid/state"});
    ASSERT_TRUE(eventually([&] { return broker_->statistics().inline_dropped > dropped; }));
    for (std::size_t taken = 0; taken < kLarge;) {
      const std::string some = slow.read_some(1 << 20, patience);
      ASSERT_FALSE(some.empty());
      taken += some.size();
    }
    EXPECT_EQ(receive_number(late), 7u);
  }

  std::optional<RawPublisher> raw_;
};

TEST_F(SmallRelay, WhatIsHeldComesToWhoCameWhileThereWasNoRoomForIt) {
  expect_to_come_late(directory_.address().subscribe_endpoint(), [&] { return connect("late"); });
}

TEST_F(SmallRelay, SoItDoesToWhoCameOverTcp) {
  expect_to_come_late(broker_->tcp_address()->subscribe_endpoint(), [&] { return connect_tcp("late"); });
}

TEST_F(Relay, AReaderThatHasLeftIsInlinedForNoMore) {
  const auto context = connect("maker");
  NumberPublisher publisher(context, "viewer/probe");
  const auto slab = context->create_slab("frames", 1, 1000);
  {
    bus::Subscriber remote(connect_tcp("remote"), {"viewer/probe"});
    meet(publisher, remote);
    publish_number(publisher, 5, false, "", {write_floats(*slab, {1})});
    ASSERT_EQ(receive_number(remote), 5u);
  }
  EXPECT_EQ(broker_->statistics().inlined, 1u);
  // The broker hears of it in its own time; then it stops.
  ASSERT_TRUE(eventually([&] {
    const auto before = broker_->statistics();
    publish_number(publisher, 6, false, "", {write_floats(*slab, {1})});
    EXPECT_TRUE(eventually([&] { return broker_->statistics().relayed > before.relayed; }));
    const auto sequence = publisher.sequence();
    for (auto message = witness_.receive(patience); message; message = witness_.receive(patience)) {
      if (message->header().sequence() == sequence) break;
    }
    return broker_->statistics().inlined == before.inlined;
  }));
}

bus::Frames frames_of(std::size_t bytes) {
  bus::Frames frames;
  frames.body.rebuild(bytes);
  return frames;
}

TEST(LatchStore, IsBoundedByMessagesAndBytesAndLosesTheOldest) {
  bus::LatchStore by_count(2, 1000);
  EXPECT_EQ(by_count.put("b", "", "s", 1, frames_of(10)).evicted, 0u);
  EXPECT_EQ(by_count.put("a", "", "s", 2, frames_of(10)).evicted, 0u);
  EXPECT_EQ(by_count.put("b", "", "s", 3, frames_of(10)).evicted, 0u) << "replaced, and so newer than a";
  EXPECT_EQ(by_count.put("c", "", "s", 4, frames_of(10)).evicted, 1u);
  EXPECT_EQ(by_count.find("a", ""), nullptr);
  EXPECT_NE(by_count.find("b", ""), nullptr);
  EXPECT_EQ(by_count.bytes(), 20u);

  bus::LatchStore by_bytes(100, 50);
  EXPECT_EQ(by_bytes.put("a", "", "s", 1, frames_of(30)).evicted, 0u);
  EXPECT_EQ(by_bytes.put("b", "", "s", 2, frames_of(20)).evicted, 0u);
  EXPECT_EQ(by_bytes.put("a", "", "s", 3, frames_of(20)).evicted, 0u);
  EXPECT_EQ(by_bytes.bytes(), 40u);
  EXPECT_EQ(by_bytes.put("c", "", "s", 4, frames_of(11)).evicted, 1u);
  EXPECT_EQ(by_bytes.find("b", ""), nullptr);
  EXPECT_EQ(by_bytes.size(), 2u);
}

TEST(LatchStore, WhatCannotFitIsRefusedAndDrivesNobodyOut) {
  bus::LatchStore store(100, 100, 0.5);
  EXPECT_TRUE(store.put("light", "", "engine", 1, frames_of(10)).held);
  EXPECT_TRUE(store.put("model", "", "trainer", 2, frames_of(20)).held);
  const auto refused = store.put("model", "", "trainer", 3, frames_of(51));
  EXPECT_FALSE(refused.held);
  EXPECT_EQ(refused.evicted, 0u);
  EXPECT_NE(store.find("light", ""), nullptr);
  EXPECT_EQ(store.find("model", ""), nullptr) << "an older one than the last would be told to who comes late";
  EXPECT_EQ(store.bytes(), 10u);
}

TEST(LatchStore, ASourceBeyondItsShareLosesItsOwn) {
  bus::LatchStore store(8, 1000, 0.5);
  store.put("light", "", "engine", 1, frames_of(1));
  for (std::uint64_t i = 2; i < 20; ++i) store.put("flood", std::to_string(i), "flooder", i, frames_of(1));
  EXPECT_NE(store.find("light", ""), nullptr);
  EXPECT_EQ(store.size(), 5u);
  EXPECT_NE(store.find("flood", "19"), nullptr);
  // Many sources together reach the bound of all: who holds the most gives way.
  for (std::uint64_t i = 20; i < 25; ++i) store.put("other", std::to_string(i), "other", i, frames_of(1));
  EXPECT_EQ(store.size(), 8u);
  EXPECT_NE(store.find("light", ""), nullptr);
}

TEST(LatchStore, ASourcesShareIsOfBytesToo) {
  bus::LatchStore store(100, 100, 0.5);
  store.put("light", "", "engine", 1, frames_of(10));
  EXPECT_EQ(store.put("flood", "2", "flooder", 2, frames_of(20)).evicted, 0u);
  EXPECT_EQ(store.put("flood", "3", "flooder", 3, frames_of(30)).evicted, 0u) << "50 bytes are its share";
  EXPECT_EQ(store.put("flood", "4", "flooder", 4, frames_of(1)).evicted, 1u);
  EXPECT_EQ(store.find("flood", "2"), nullptr);
  EXPECT_EQ(store.bytes(), 41u);
}

TEST(LatchStore, ThoseThatAreFarDriveNobodyOutWhoIsNear) {
  bus::LatchStore store(100, 10000, 0.5);
  std::uint64_t order = 0;
  const auto put = [&](const std::string& topic, const std::string& source, bool far) {
    return store.put(topic, "", source, ++order, frames_of(1), 0, far);
  };
  for (int i = 0; i < 20; ++i) EXPECT_TRUE(put("scene/" + std::to_string(i), "engine", false).held);
  // Many names with little each: the engine holds the most of all.
  for (int i = 0; i < 500; ++i) put("far/" + std::to_string(i), "far" + std::to_string(i), true);
  EXPECT_EQ(store.size(), 20U + 50U) << "all of them together have half";
  for (int i = 0; i < 20; ++i) EXPECT_NE(store.find("scene/" + std::to_string(i), ""), nullptr) << i;
  // And they make room.
  for (int i = 20; i < 50; ++i) put("scene/" + std::to_string(i), "engine", false);
  for (int i = 0; i < 40; ++i) put("model/" + std::to_string(i), "trainer", false);
  EXPECT_EQ(store.size(), 100U);
  for (int i = 0; i < 50; ++i) EXPECT_NE(store.find("scene/" + std::to_string(i), ""), nullptr) << i;
  for (int i = 0; i < 40; ++i) EXPECT_NE(store.find("model/" + std::to_string(i), ""), nullptr) << i;
}

TEST(LatchStore, SaysWhenTheMessageItselfHasToLeave) {
  bus::LatchStore store(100, 100, 0.5);
  EXPECT_TRUE(store.put("a", "", "a", 1, frames_of(30), 0, true).held);
  const auto put = store.put("b", "", "b", 2, frames_of(40), 0, true);
  EXPECT_FALSE(put.held) << "its source is the one that holds the most";
  EXPECT_EQ(put.evicted, 0U);
  EXPECT_EQ(store.find("b", ""), nullptr);
  EXPECT_NE(store.find("a", ""), nullptr);
}

TEST(LatchStore, MatchesAPrefixOldestFirst) {
  bus::LatchStore store(10, 1000);
  store.put("x/b", "1", "s", 1, frames_of(1), 11);
  store.put("x/a", "1", "s", 2, frames_of(1), 12);
  store.put("y/a", "1", "s", 3, frames_of(1), 13);
  store.put("x/b", "0", "s", 4, frames_of(1), 14);
  std::vector<std::int64_t> stamps;
  for (const auto& held : store.matching("x/")) stamps.push_back(held.stamp);
  EXPECT_EQ(stamps, (std::vector<std::int64_t>{11, 12, 14}));
}

}  // namespace
}  // namespace splatbus::bus_test
