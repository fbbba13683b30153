// Peers that make the broker keep what is too much, or keep from others what there is room for.
#include <gmock/gmock.h>
#include <sys/socket.h>
#include <unistd.h>

#include <atomic>
#include <thread>

#include "../unit/bus/bus_fixture.h"
#include "../unit/bus/fake_broker.h"
#include "budgets.h"
#include "bus/clock.h"
#include "many_bytes.h"
#include "raw_zmtp.h"
#include "wire/system_generated.h"

namespace splatbus::hostile {
namespace {

using bus_test::eventually;
using bus_test::NumberPublisher;
using bus_test::patience;
using bus_test::publish_number;
using bus_test::RawPublisher;
using bus_test::receive_number;
using namespace std::chrono_literals;

constexpr std::size_t kBudget = 48 * kMiB;

class HostileQueues : public bus_test::BusTest {
 protected:
  HostileQueues() {
    broker_.reset();
    auto bounded = options();
    bounded.max_remote_bytes = kBudget;
    broker_ = std::make_unique<bus_service::Broker>(bounded);
    broker_->start();
  }
  [[nodiscard]] std::string readers() const { return broker_->tcp_address()->subscribe_endpoint(); }
  [[nodiscard]] std::string readers_here() const { return directory_.address().subscribe_endpoint(); }

  /// The longest time without a message, and the most memory meanwhile.
  struct Seen {
    double longest_gap_s = 0;
    std::size_t messages = 0, most_bytes = 0;
  };
  static Seen read_for(bus::Subscriber& reader, std::chrono::seconds time) {
    Seen seen;
    const std::int64_t end = bus::now_ns() + std::chrono::nanoseconds(time).count();
    std::int64_t heard_ns = bus::now_ns();
    while (bus::now_ns() < end) {
      const bool heard = reader.receive(20ms).has_value();
      const std::int64_t now = bus::now_ns();
      seen.longest_gap_s = std::max(seen.longest_gap_s, static_cast<double>(now - heard_ns) * 1e-9);
      seen.most_bytes = std::max(seen.most_bytes, resident_bytes(::getpid()));
      if (!heard) continue;
      heard_ns = now;
      ++seen.messages;
    }
    return seen;
  }
};

/// Reads 80 kB/s, which is more than nothing, and comes again when it is closed.
class Trickler {
 public:
  explicit Trickler(const std::string& endpoint)
      : thread_([this, endpoint](const std::stop_token& stop) {
          while (!stop.stop_requested()) {
            RawZmtp raw(endpoint);
            const int small = 16384;
            ::setsockopt(raw.fd(), SOL_SOCKET, SO_RCVBUF, &small, sizeof(small));
            if (!raw.handshake("SUB") || !raw.send_frame("\x01model/", false)) continue;
            ++connections_;
            while (!stop.stop_requested() && !raw.read_some(8000, 500ms).empty()) std::this_thread::sleep_for(100ms);
          }
        }) {}
  [[nodiscard]] int connections() const { return connections_; }

 private:
  std::atomic<int> connections_ = 0;
  std::jthread thread_;
};

TEST_F(HostileQueues, AReaderThatTricklesKeepsNothingFromOthersForLong) {
  const ManyBytes model(connect("trainer"), "model/held", 50ms);
  bus::Subscriber good(connect_tcp("good"), {"model/held"});
  ASSERT_TRUE(good.receive(patience).has_value());
  const Trickler trickler(readers());
  ASSERT_TRUE(eventually([&] { return trickler.connections() > 0; }));
  // Three copies fill the budget, and one takes it 200 s to read.
  const Seen seen = read_for(good, 12s);
  EXPECT_LT(seen.longest_gap_s, 6);
  EXPECT_GT(seen.messages, 6U);
  EXPECT_GE(trickler.connections(), 2) << "it was closed";
}

TEST_F(HostileQueues, WhatComesWithinMessagesIsBoundedWhoeverDoesNotReadIt) {
  const std::size_t before = resident_bytes(::getpid());
  const ManyBytes model(connect_tcp("trainer"), "model/held", 100ms);
  bus::Subscriber good(connect("good"), {"model/held"}), far(connect_tcp("far"), {"model/held"});
  ASSERT_TRUE(good.receive(patience).has_value());
  ASSERT_TRUE(far.receive(patience).has_value());
  RawZmtp stopped(readers_here()), deaf(readers());
  for (RawZmtp* raw : {&stopped, &deaf}) {
    ASSERT_TRUE(raw->handshake("SUB"));
    ASSERT_TRUE(raw->send_frame("\x01model/", false));
  }
  std::atomic<std::size_t> far_messages = 0;
  const std::jthread far_reader([&](const std::stop_token& stop) {
    while (!stop.stop_requested()) {
      if (far.receive(20ms)) ++far_messages;
    }
  });
  const Seen seen = read_for(good, 10s);
  // Two budgets; the publisher's slab of 32 MiB, what it and the broker hold, and what is on its way between them.
  EXPECT_LT(seen.most_bytes, before + 2 * kBudget + 160 * kMiB) << "10 s of it are 1600 MiB";
  EXPECT_LT(seen.longest_gap_s, 6);
  EXPECT_GT(seen.messages, 20U);
  EXPECT_GT(far_messages, 20U);
  EXPECT_TRUE(stopped.closed_within(5s));
  EXPECT_GT(broker_->statistics().inline_dropped, 0U);
}

TEST_F(HostileQueues, WhoSubscribesToEverythingTakesNobodysPlace) {
  RawZmtp greedy(readers());
  ASSERT_TRUE(greedy.handshake("SUB"));
  for (int i = 0; i < 5000; ++i) {
    if (!greedy.send_frame("\x01" + std::to_string(i), false)) break;
  }
  NumberPublisher publisher(connect("maker"), "viewer/probe");
  bus::Subscriber good(connect_tcp("good"), {"viewer/probe"});
  meet(publisher, good);
  EXPECT_TRUE(greedy.closed_within(5s)) << "it asked for more than a reader may";
  // Before, while and after the broker forgets what it asked for.
  const auto end = std::chrono::steady_clock::now() + 1500ms;
  for (std::uint64_t number = 7; std::chrono::steady_clock::now() < end; ++number) {
    publish_number(publisher, number);
    ASSERT_EQ(receive_number(good), number);
  }
}

std::string heartbeat(const std::string& source, const std::string& service) {
  flatbuffers::FlatBufferBuilder builder;
  builder.ForceDefaults(true);
  const auto header = wire::CreateHeaderDirect(builder, std::string(topics::kHeartbeat.schema).c_str(), source.c_str(),
                                               1, 1, 0, 0, 0, true, source.c_str());
  builder.Finish(wire::CreateHeartbeatDirect(builder, header, service.c_str(), 1, wire::ServiceState::Running));
  return {reinterpret_cast<const char*>(builder.GetBufferPointer()), builder.GetSize()};
}

TEST_F(HostileQueues, HeartbeatsThatSayMuchAreRefusedAndLivenessIsHeardOn) {
  RawPublisher raw(directory_.address().publish_endpoint());
  const std::string much(40 * kMiB, 'x');
  for (const char* name : {"one", "two"}) raw.send({"sys/heartbeat", heartbeat(name, much)});
  raw.send({"sys/heartbeat", heartbeat("three", "trainer")});
  ASSERT_TRUE(eventually([&] { return broker_->statistics().malformed == 2; })) << broker_->statistics().malformed;
  bus::Subscriber liveness(connect("reader"), {"sys/liveness"});
  EXPECT_TRUE(eventually([&] {
    const auto message = liveness.receive(100ms);
    if (!message) return false;
    EXPECT_LT(message->size(), kMiB);
    const auto* nodes = message->root<wire::Liveness>().nodes();
    return std::ranges::any_of(*nodes, [](const wire::Node* node) { return node->source()->string_view() == "three"; });
  }));
  EXPECT_EQ(liveness.malformed(), 0U);
}

}  // namespace
}  // namespace splatbus::hostile
