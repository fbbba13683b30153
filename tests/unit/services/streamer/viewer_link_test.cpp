// A hub and a viewer's follower behind a link of arithmetic, under one clock: what a cut, a slow line and losses cost.
// Of the hub's endpoint this file has another one, without sockets, which is linked in that one's place.
#include <gtest/gtest.h>

#include <deque>
#include <map>
#include <set>

#include "../../stream/toy_server.h"
#include "link_schedule.h"
#include "stream/follower.h"
#include "streamer/viewer_hub.h"

namespace splatbus::streamer {
namespace {

using cli::LinkCut;
using cli::LinkSchedule;
using cli::LinkShape;

constexpr std::int64_t kSecond = 1'000'000'000, kStep = kSecond / 200, kTick = kSecond / 5;

/// One way of a tcp connection: what the sender's socket holds, and behind it the link.
template <class Message>
class Way {
 public:
  explicit Way(const LinkShape& shape, std::uint64_t seed) : schedule_(shape, seed) {}

  void cut(const LinkCut& cut) { schedule_.cut(cut); }
  [[nodiscard]] double held_bytes() const { return held_bytes_; }
  void send(Message message, std::size_t bytes) {
    held_bytes_ += static_cast<double>(bytes);
    messages_.push_back({std::move(message), bytes, 0, 0});
  }
  /// The next that has come by now.
  std::optional<Message> receive(std::int64_t now_ns) {
    while (!on_the_way_.empty() && on_the_way_.front().first <= now_ns) {
      way_bytes_ -= on_the_way_.front().second;
      on_the_way_.pop_front();
    }
    for (Entry& entry : messages_) {
      while (entry.given < entry.bytes && !schedule_.full(way_bytes_, now_ns)) {
        const std::size_t bytes = std::min(LinkSchedule::kSegmentBytes, entry.bytes - entry.given);
        entry.there_ns = schedule_.send(bytes, now_ns);
        entry.given += bytes;
        way_bytes_ += bytes;
        on_the_way_.emplace_back(entry.there_ns, bytes);
      }
      if (entry.given < entry.bytes) break;
    }
    if (messages_.empty() || messages_.front().given < messages_.front().bytes || messages_.front().there_ns > now_ns) {
      return std::nullopt;
    }
    Message message = std::move(messages_.front().message);
    held_bytes_ -= static_cast<double>(messages_.front().bytes);
    messages_.pop_front();
    return message;
  }

 private:
  struct Entry {
    Message message;
    std::size_t bytes = 0, given = 0;
    std::int64_t there_ns = 0;
  };
  LinkSchedule schedule_;
  std::deque<Entry> messages_;
  std::deque<std::pair<std::int64_t, std::size_t>> on_the_way_;
  std::size_t way_bytes_ = 0;
  double held_bytes_ = 0;
};

/// As ZeroMQ over tcp: its queue and the kernel's take about so much before they say that they are full.
constexpr double kSocketBytes = 3e6;

struct Connection {
  Connection(const LinkShape& shape, std::uint64_t seed) : down(shape, seed), up(shape, seed + 1) {}
  Way<stream::EncodedPacket> down, up;
  bool gone = false;  ///< the streamer's end has noticed
};

struct Network {
  std::map<std::string, Connection> connections;
  std::deque<Endpoint::Received> come;
};
Network& network() {
  static Network all;
  return all;
}

}  // namespace

WirePacket::WirePacket(const stream::EncodedPacket& packet)
    : body_(packet.body),
      sequence_at_(stream::sequence_offset(packet.packet)),
      packet_(packet.packet.data(), packet.packet.size()),
      payload_(packet.payload.data(), packet.payload.size()) {}

stream::EncodedPacket WirePacket::copy() const {
  const auto bytes = [](const zmq::message_t& message) {
    const auto* data = message.data<std::uint8_t>();
    return stream::Bytes(data, data + message.size());
  };
  return {.body = body_, .sequence = 0, .packet = bytes(packet_), .payload = bytes(payload_)};
}

Endpoint::Endpoint(const std::vector<std::string>&, const EndpointOptions&) {}

Endpoint::Sent Endpoint::send(const Peer& peer, const WirePacket& packet, std::uint64_t sequence) {
  const auto found = network().connections.find(peer);
  if (found == network().connections.end() || found->second.gone) return Sent::Gone;
  if (found->second.down.held_bytes() > kSocketBytes) return Sent::Full;
  stream::EncodedPacket copy = packet.copy();
  if (sequence != 0) stream::set_sequence(copy, sequence);
  found->second.down.send(std::move(copy), packet.bytes());
  return Sent::Yes;
}

std::optional<Endpoint::Received> Endpoint::receive() {
  if (network().come.empty()) return std::nullopt;
  Received first = std::move(network().come.front());
  network().come.pop_front();
  return first;
}

namespace {

class ViewerLinkTest : public testing::Test {
 protected:
  static constexpr std::int64_t kHeartbeatNs = 3 * kSecond, kServersHeartbeatNs = 5 * kSecond, kConnectNs = kSecond;

  ViewerLinkTest() { network() = {}; }

  void begin(const LinkShape& shape, double viewer_kbps = 9000) {
    shape_ = shape;
    hub_.set_rate(viewer_kbps);
    ASSERT_TRUE(server_.stream.observe(server_.model().view()));
    hub_.add({});
    connect();
  }
  void connect() {
    name_ = "viewer" + std::to_string(network().connections.size());
    Connection& made = network().connections.try_emplace(name_, shape_, network().connections.size() * 2).first->second;
    made.down.cut(cut_);
    made.up.cut(cut_);
    connected_ns_ = heard_ns_ = now_ns_;
  }
  void cut(double seconds) {
    cut_ = {.from_ns = now_ns_, .to_ns = now_ns_ + static_cast<std::int64_t>(seconds * 1e9)};
    for (auto& [name, connection] : network().connections) {
      connection.down.cut(cut_);
      connection.up.cut(cut_);
    }
  }

  /// What the kernel and ZeroMQ do with a connection that says nothing.
  void keep_connected() {
    for (auto& [name, connection] : network().connections) {
      if (name != name_ && now_ns_ - lost_ns_[name] > kServersHeartbeatNs - kHeartbeatNs) connection.gone = true;
    }
    if (connected_ && now_ns_ - heard_ns_ > kHeartbeatNs) {
      lost_ns_[name_] = now_ns_;
      connected_ = false;
      retry_ns_ = now_ns_;
    }
    if (!connected_ && now_ns_ >= retry_ns_) {
      retry_ns_ += kConnectNs;
      if (cut_.contains(now_ns_)) return;
      connected_ = true;
      connect();
    }
  }

  void step() {
    now_ns_ += kStep;
    keep_connected();
    if (now_ns_ % kTick == 0) tick();
    if (connected_) {
      Connection& connection = network().connections.at(name_);
      while (auto packet = connection.down.receive(now_ns_)) {
        heard_ns_ = now_ns_;
        if (packet->body == wire::Body::PageDelta || packet->body == wire::Body::Page) {
          longest_gap_ns_ = std::max(longest_gap_ns_, now_ns_ - come_ns_);
          come_ns_ = now_ns_;
        }
        follower_.receive(packet->packet, packet->payload, now_ns_);
      }
      while (auto packet = follower_.next_outgoing(now_ns_)) {
        const std::size_t bytes = packet->bytes();
        connection.up.send(std::move(*packet), bytes);
      }
      while (auto packet = connection.up.receive(now_ns_)) {
        network().come.push_back({.peer = name_, .packet = stream::ParsedPacket::parse(packet->packet, {})});
      }
      on_the_way_ = connection.down.held_bytes();
    }
    hub_.receive(now_ns_);
    hub_.pump(now_ns_);
    if (now_ns_ % kSecond == 0) {
      hub_.send_keepalive(now_ns_);
      hub_.expire(now_ns_);
    }
  }
  void live(double seconds, const std::function<void()>& each = {}) {
    for (const std::int64_t end = now_ns_ + static_cast<std::int64_t>(seconds * 1e9); now_ns_ < end;) {
      step();
      if (each) each();
    }
  }

  /// As the streamer: within the fastest viewer's rate.
  void tick() {
    if (training_) server_.train(0.02F);
    ASSERT_TRUE(server_.stream.observe(server_.model().view()));
    const double bytes_per_s = std::min(500e3, 2.0 / 3 * hub_.most_bytes_per_s().value_or(1e18));
    server_.stream.set_holders(hub_.holders());
    server_.stream.make_tick(bytes_per_s / 5, {});
    hub_.add(server_.stream.take_update());
    for (const stream::OfferedPage& page : *server_.stream.offered()) {
      since_[page.page].emplace(page.version, now_ns_);
    }
  }

  /// For how long the page that is most behind has been behind, s; nullopt while one is missing.
  [[nodiscard]] std::optional<double> behind_s() const {
    double most = 0;
    for (const auto& [page, versions] : since_) {
      const stream::HeldPage* held = follower_.replica().held().find(page);
      if (!held || !held->whole()) return std::nullopt;
      const auto newer = versions.upper_bound(held->version);
      if (newer != versions.end()) most = std::max(most, static_cast<double>(now_ns_ - newer->second) * 1e-9);
    }
    return most;
  }
  /// Until no page is more behind than that, s; a minute where that never is.
  double until_within(double most_s) {
    const std::int64_t begin_ns = now_ns_;
    while (now_ns_ - begin_ns < 60 * kSecond) {
      if (const auto behind = behind_s(); behind && *behind <= most_s) break;
      step();
    }
    return static_cast<double>(now_ns_ - begin_ns) * 1e-9;
  }

  stream::test::ToyServer server_{5, 15'000};
  Endpoint endpoint_{{}};
  ViewerHub hub_{endpoint_, server_.stream, stream::PacketWriter("streamer", 1), HubOptions{}, HubEvents{}};
  stream::Follower follower_{{.name = "viewer"}, 0};
  LinkShape shape_;
  LinkCut cut_;
  std::string name_;
  std::map<std::string, std::int64_t> lost_ns_;
  std::map<std::uint32_t, std::map<std::uint32_t, std::int64_t>> since_;  ///< by page and version
  std::int64_t now_ns_ = kSecond, connected_ns_ = 0, heard_ns_ = 0, retry_ns_ = 0, come_ns_ = 0, longest_gap_ns_ = 0;
  bool connected_ = true, training_ = true;
  double on_the_way_ = 0;
};

TEST_F(ViewerLinkTest, AfterACutOfTenSecondsNothingIsOldWithinTwo) {
  begin({.round_trip_ms = 20});
  live(6);
  ASSERT_LE(behind_s().value_or(99), 0.5);
  cut(10);
  live(10);
  EXPECT_LE(until_within(1), 2);
  double worst = 0;
  live(4, [&] { worst = std::max(worst, behind_s().value_or(99)); });
  EXPECT_LE(worst, 1.2);
}

TEST_F(ViewerLinkTest, ACutThatTheConnectionOutlivesLeavesNothingOldOnTheWay) {
  begin({.round_trip_ms = 20});
  live(6);
  cut(2.5);
  double most = 0;
  live(2.5, [&] { most = std::max(most, on_the_way_); });
  EXPECT_LE(most, 9000 * 125 * 0.5) << "half a second's worth";
  // The kernel tries again after 0.22, 0.44, 0.88, 1.76 s: its last before the end is at 1.54 s, and the next at 3.3.
  EXPECT_LE(until_within(1), 2);
}

TEST_F(ViewerLinkTest, OfASlowLineTheQueueStaysShort) {
  begin({.round_trip_ms = 50, .mbps = 2});
  live(8);
  double most = 0;
  live(10, [&] { most = std::max(most, on_the_way_); });
  EXPECT_LE(most, 2e6 / 8 * 0.7) << "bytes that wait for the line";
  EXPECT_GT(hub_.most_bytes_per_s().value_or(0), 0.7 * 2e6 / 8) << "the line is used";
  EXPECT_LT(hub_.most_bytes_per_s().value_or(0), 1.4 * 2e6 / 8);
  training_ = false;
  live(10);
  EXPECT_LE(behind_s().value_or(99), 0.5);
}

TEST_F(ViewerLinkTest, LossesHoldThePictureUpForAMomentOnly) {
  begin({.round_trip_ms = 100, .loss = 0.02});
  live(4);
  longest_gap_ns_ = 0;
  double worst = 0;
  live(10, [&] { worst = std::max(worst, behind_s().value_or(99)); });
  EXPECT_LE(worst, 1.5);
  EXPECT_LE(longest_gap_ns_, kSecond);
}

}  // namespace
}  // namespace splatbus::streamer
