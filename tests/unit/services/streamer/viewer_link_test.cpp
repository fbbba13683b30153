// A hub and viewers' followers behind links of arithmetic, under one clock: what a cut, a slow line and losses cost.
// Of the hub's endpoint this file has another one, without sockets, which is linked in that one's place.
#include <gtest/gtest.h>

#include <deque>
#include <functional>
#include <map>
#include <memory>

#include "../../nanoseconds.h"
#include "../../stream/toy_server.h"
#include "link_schedule.h"
#include "stream/follower.h"
#include "streamer/viewer_hub.h"

namespace splatbus::streamer {
namespace {

using cli::LinkCut;
using cli::LinkSchedule;
using cli::LinkShape;

constexpr std::int64_t kStep = kSecond / 200, kTick = kSecond / 5;

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

/// A viewer behind a link, and what the kernel and ZeroMQ do with a connection that says nothing.
class Guest {
 public:
  Guest(std::string name, const LinkShape& shape, std::int64_t now_ns)
      : follower({.name = name}, now_ns), shape_(shape), prefix_(std::move(name)) {
    connect(now_ns);
  }

  void cut(const LinkCut& cut) {
    cut_ = cut;
    for (Connection* connection : connections_) {
      connection->down.cut(cut_);
      connection->up.cut(cut_);
    }
  }
  void step(std::int64_t now_ns) {
    keep_connected(now_ns);
    if (!connected_) return;
    Connection& connection = *connections_.back();
    while (reads) {
      const auto packet = connection.down.receive(now_ns);
      if (!packet) break;
      heard_ns_ = now_ns;
      bytes += packet->bytes();
      if (packet->body == wire::Body::PageDelta || packet->body == wire::Body::Page) {
        longest_gap_ns = std::max(longest_gap_ns, now_ns - come_ns_);
        come_ns_ = now_ns;
      }
      if (packet->body == wire::Body::Keepalive) {
        const auto parsed = stream::ParsedPacket::parse(packet->packet, packet->payload);
        told_bytes_per_s = 125.0 * parsed.root().body_as_Keepalive()->kbps();
      }
      follower.receive(packet->packet, packet->payload, now_ns);
    }
    if (!reads) heard_ns_ = now_ns;  // its program does not; the connection lives
    follower.set_camera(look_at({1, 2, 3}, {0, 0, 0}, 64, 48, 1));
    while (auto packet = follower.next_outgoing(now_ns)) {
      if (packet->body == wire::Body::Held && !acknowledges) continue;
      const std::size_t size = packet->bytes();
      connection.up.send(std::move(*packet), size);
    }
    while (auto packet = connection.up.receive(now_ns)) {
      network().come.push_back({.peer = peer_, .packet = stream::ParsedPacket::parse(packet->packet, {})});
    }
    most_on_the_way = std::max(most_on_the_way, connection.down.held_bytes());
  }

  stream::Follower follower;
  bool reads = true, acknowledges = true;
  std::uint64_t bytes = 0;
  double most_on_the_way = 0;   ///< since the test set it to 0
  double told_bytes_per_s = 0;  ///< by the last Keepalive: its rate
  std::int64_t longest_gap_ns = 0;

 private:
  static constexpr std::int64_t kHeartbeatNs = 5 * kSecond, kConnectNs = kSecond;

  void connect(std::int64_t now_ns) {
    peer_ = prefix_ + std::to_string(connections_.size());
    auto& all = network().connections;
    Connection& made = all.try_emplace(peer_, shape_, all.size() * 2).first->second;
    made.down.cut(cut_);
    made.up.cut(cut_);
    connections_.push_back(&made);
    connected_ = true;
    heard_ns_ = now_ns;
  }
  void keep_connected(std::int64_t now_ns) {
    if (connected_ && now_ns - heard_ns_ > kHeartbeatNs) {
      connections_.back()->gone = true;  // the streamer's end has waited for as long
      connected_ = false;
      retry_ns_ = now_ns;
    }
    if (!connected_ && now_ns >= retry_ns_) {
      retry_ns_ += kConnectNs;
      if (!cut_.contains(now_ns)) connect(now_ns);
    }
  }

  LinkShape shape_;
  LinkCut cut_;
  std::string prefix_, peer_;
  std::vector<Connection*> connections_;  ///< the last is the one of now
  bool connected_ = false;
  std::int64_t heard_ns_ = 0, retry_ns_ = 0, come_ns_ = 0;
};

class ViewerLinkTest : public testing::Test {
 protected:
  ViewerLinkTest() {
    network() = {};
    EXPECT_TRUE(server_.stream.observe(server_.model().view()));
    hub_.add({});
  }

  Guest& join(const std::string& name, const LinkShape& shape) {
    return *guests_.emplace_back(std::make_unique<Guest>(name, shape, now_ns_));
  }
  void cut(Guest& guest, double seconds) {
    guest.cut({.from_ns = now_ns_, .to_ns = now_ns_ + static_cast<std::int64_t>(seconds * 1e9)});
  }

  void step() {
    now_ns_ += kStep;
    if (now_ns_ % kTick == 0) tick();
    for (const auto& guest : guests_) guest->step(now_ns_);
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
    const double bytes_per_s = std::min(500e3, hub_.delta_bytes_per_s().value_or(1e18));
    server_.stream.set_holders(hub_.followed_pages());
    server_.stream.make_tick(bytes_per_s / 5, {});
    hub_.add(server_.stream.take_update());
    for (const stream::OfferedPage& page : *server_.stream.offered()) {
      since_[page.page].emplace(page.version, now_ns_);
    }
  }

  /// For how long the page that is most behind has been behind, s; nullopt while one is missing.
  [[nodiscard]] std::optional<double> behind_s(const Guest& guest) const {
    double most = 0;
    for (const auto& [page, versions] : since_) {
      const stream::HeldPage* held = guest.follower.replica().held().find(page);
      if (!held || !held->whole()) return std::nullopt;
      const auto newer = versions.upper_bound(held->version);
      if (newer != versions.end()) most = std::max(most, static_cast<double>(now_ns_ - newer->second) * 1e-9);
    }
    return most;
  }
  /// The most of that while it lives on, s.
  double most_behind_s(const Guest& guest, double seconds) {
    double most = 0;
    live(seconds, [&] { most = std::max(most, behind_s(guest).value_or(99)); });
    return most;
  }
  /// Until no page is more behind than that, s; a minute where that never is.
  double until_within(const Guest& guest, double most_s) {
    const std::int64_t begin_ns = now_ns_;
    while (now_ns_ - begin_ns < 60 * kSecond) {
      if (const auto behind = behind_s(guest); behind && *behind <= most_s) break;
      step();
    }
    return static_cast<double>(now_ns_ - begin_ns) * 1e-9;
  }

  static constexpr double kKbps = 9000, kBytes_s = kKbps * 125;
  stream::test::ToyServer server_{5, 15'000};
  Endpoint endpoint_{{}};
  ViewerHub hub_{endpoint_, server_.stream, stream::PacketWriter("streamer", 1), HubOptions{.viewer_kbps = kKbps},
                 HubEvents{.pose = [](const auto&, const auto&) {},
                           .probe = [](const auto&, const auto&) {},
                           .quality = [](const auto&, const auto&) {}}};
  std::vector<std::unique_ptr<Guest>> guests_;
  std::map<std::uint32_t, std::map<std::uint32_t, std::int64_t>> since_;  ///< by page and version
  std::int64_t now_ns_ = kSecond;
  bool training_ = true;
};

TEST_F(ViewerLinkTest, AfterACutOfTenSecondsNothingIsOldWithinTwo) {
  Guest& viewer = join("viewer", {.round_trip_ms = 20});
  live(6);
  ASSERT_LE(behind_s(viewer).value_or(99), 0.5);
  cut(viewer, 10);
  live(10);
  EXPECT_LE(until_within(viewer, 1), 2);
  EXPECT_LE(most_behind_s(viewer, 4), 1.2);
}

TEST_F(ViewerLinkTest, ACutThatTheConnectionOutlivesLeavesNothingOldOnTheWay) {
  Guest& viewer = join("viewer", {.round_trip_ms = 20});
  live(6);
  cut(viewer, 2.5);
  viewer.most_on_the_way = 0;
  live(2.5);
  EXPECT_LE(viewer.most_on_the_way, 0.5 * kBytes_s);
  // The kernel tries again after 0.22, 0.44, 0.88, 1.76 s: its last before the end is at 1.54 s, and the next at 3.3.
  EXPECT_LE(until_within(viewer, 1), 2);
}

TEST_F(ViewerLinkTest, OfASlowLineTheQueueStaysShort) {
  Guest& viewer = join("viewer", {.round_trip_ms = 50, .mbps = 2});
  live(8);
  viewer.most_on_the_way = 0;
  live(10);
  EXPECT_LE(viewer.most_on_the_way, 2e6 / 8 * 0.7) << "bytes that wait for the line";
  EXPECT_GT(viewer.told_bytes_per_s, 0.7 * 2e6 / 8) << "the line is used";
  EXPECT_LT(viewer.told_bytes_per_s, 1.4 * 2e6 / 8);
  training_ = false;
  live(10);
  EXPECT_LE(behind_s(viewer).value_or(99), 0.5);
}

TEST_F(ViewerLinkTest, LossesHoldThePictureUpForAMomentOnly) {
  Guest& viewer = join("viewer", {.round_trip_ms = 100, .loss = 0.02});
  live(4);
  viewer.longest_gap_ns = 0;
  EXPECT_LE(most_behind_s(viewer, 10), 1.5);
  EXPECT_LE(viewer.longest_gap_ns, kSecond);
}

// As one whose program has stopped, or whose way down alone is cut.
TEST_F(ViewerLinkTest, WhoReadsNothingForTenSecondsIsSentNoMoreThanTheBoundAndIsWholeSoonAfter) {
  Guest& viewer = join("viewer", {.round_trip_ms = 20, .mbps = 8});
  Guest& other = join("other", {.round_trip_ms = 20});
  live(6);
  ASSERT_LE(behind_s(viewer).value_or(99), 0.5);
  const double usual_s = most_behind_s(other, 4);
  viewer.reads = false;
  viewer.most_on_the_way = 0;
  EXPECT_LE(most_behind_s(other, 10), usual_s + 0.2) << "another one waits for it";
  EXPECT_LE(viewer.most_on_the_way, 0.5 * kBytes_s + 10 * ViewerRate::kSilentBytes_s);
  viewer.reads = true;
  EXPECT_LE(until_within(viewer, 1), 2);
  EXPECT_EQ(hub_.viewers(), 2U);
  EXPECT_EQ(hub_.lost_viewers(), 0U) << "it was not even forgotten";
}

TEST_F(ViewerLinkTest, WhoNeverAcknowledgesIsServedSlowlyAndWithoutAnEnd) {
  Guest& silent = join("silent", {});
  Guest& other = join("other", {});
  silent.acknowledges = false;
  live(2);
  const double usual_s = most_behind_s(other, 4);
  EXPECT_LE(static_cast<double>(silent.bytes), ViewerRate::kFirstWindow + 6 * ViewerRate::kSilentBytes_s);
  const std::uint64_t before = silent.bytes;
  for (int k = 0; k < 4; ++k) {
    const std::uint64_t then = silent.bytes;
    EXPECT_LE(most_behind_s(other, 10), usual_s + 0.2) << "another one waits for it";
    EXPECT_GT(silent.bytes, then);
  }
  const auto sent = static_cast<double>(silent.bytes - before);
  EXPECT_LE(sent, 44 * ViewerRate::kSilentBytes_s);
  EXPECT_GE(sent, 34 * ViewerRate::kSilentBytes_s);
  EXPECT_EQ(hub_.viewers(), 2U);
}

}  // namespace
}  // namespace splatbus::streamer
