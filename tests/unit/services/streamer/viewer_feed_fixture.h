#pragma once

#include <gtest/gtest.h>

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <utility>
#include <vector>

#include "../../nanoseconds.h"
#include "../../stream/expectations.h"
#include "../../stream/toy_server.h"
#include "streamer/viewer_feed.h"

namespace splatbus::streamer {

using stream::test::expect_exact;

inline constexpr std::int64_t kTick = kSecond / 5, kStep = kSecond / 100;

/// A viewer without a network: what its feed gives arrives, unless it is lost.
struct Seat {
  explicit Seat(double kbps, std::size_t max_gaussians = stream::kMaxGaussians)
      : feed(max_gaussians), replica(max_gaussians) {
    feed.rate().set(kbps, 0, 0);
  }

  void read(stream::StreamModel& model, PageBoard& board, std::int64_t now_ns) {
    while (const SharedPacket packet = feed.next(model, board, gaze, {}, now_ns)) {
      const std::uint64_t sequence = feed.next_sequence();
      feed.sent(now_ns);
      bytes += packet->bytes();
      sent.emplace_back(packet->body(), packet->bytes());
      if (lose > 0 && packet->body() == lost) {
        --lose;
        continue;
      }
      stream::EncodedPacket copy = packet->copy();
      stream::set_sequence(copy, sequence);
      replica.receive(stream::test::parse(copy));
    }
  }
  /// As often as a follower.
  void say(const stream::StreamModel& model, std::int64_t now_ns) {
    const std::int64_t every_ns = bytes - said_bytes >= 32'768 ? kSecond / 20 : kSecond / 4;
    if (bytes == said_bytes || now_ns - said_ns < every_ns) return;
    said_bytes = bytes;
    said_ns = now_ns;
    const auto& report = replica.report();
    (void)feed.acknowledge(
        {.newest = report.newest, .missing = report.missing, .lacks = report.lacks, .dropped = report.dropped}, model,
        now_ns);
    replica.clear_report();
  }

  /// By whose number it knows what was lost before it.
  void keep_alive(const stream::StreamModel& model, std::int64_t now_ns) {
    const stream::PacketWriter writer("streamer", 1);
    auto packet = writer.write(model.status().epoch, 0, wire::Body::Keepalive,
                               [](auto& builder) { return wire::CreateKeepalive(builder); });
    stream::set_sequence(packet, feed.next_sequence());
    feed.sent_beside(static_cast<double>(packet.bytes()), now_ns);
    bytes += packet.bytes();
    replica.receive(stream::test::parse(packet));
  }

  ViewerFeed feed;
  stream::test::ShownReplica replica;
  std::optional<ViewerGaze> gaze;
  std::uint64_t bytes = 0, said_bytes = 0;
  std::int64_t said_ns = 0;
  std::vector<std::pair<wire::Body, std::size_t>> sent;
  wire::Body lost = wire::Body::NONE;
  int lose = 0;
};

class ViewerFeedTest : public testing::Test {
 protected:
  void sit(Seat& seat) {
    seat.feed.begin({std::make_shared<WirePacket>(server_.stream.layout_packet()),
                     std::make_shared<WirePacket>(*server_.stream.scene_packet())});
    std::vector<stream::OfferedPage> changed;
    (void)board_.add({}, changed);
  }
  void tick(const std::vector<Seat*>& seats, float amount = 0.02F) {
    if (amount > 0) server_.train(amount);
    ASSERT_TRUE(server_.stream.observe(server_.model().view()));
    std::set<std::uint32_t> holders;
    for (const Seat* seat : seats) seat->feed.follow_pages(holders);
    server_.stream.set_holders(holders);
    server_.stream.make_tick(1e9, {});
    std::vector<stream::OfferedPage> changed;
    stream::StreamUpdate update = server_.stream.take_update();
    const std::vector<std::uint32_t> ended = update.gone;
    (void)board_.add(std::move(update), changed);
    for (Seat* seat : seats) seat->feed.push_gone(server_.stream, ended);
  }
  /// So many seconds with a tick every fifth of one.
  void live(const std::vector<Seat*>& seats, double seconds, float amount = 0.02F,
            const std::function<void()>& each = {}) {
    for (const std::int64_t end = now_ns_ + static_cast<std::int64_t>(seconds * 1e9); now_ns_ < end; now_ns_ += kStep) {
      if (now_ns_ % kTick == 0 && amount >= 0) tick(seats, amount);
      for (Seat* seat : seats) seat->read(server_.stream, board_, now_ns_);
      for (Seat* seat : seats) {
        if (now_ns_ % kSecond == 0) seat->keep_alive(server_.stream, now_ns_);
        seat->say(server_.stream, now_ns_);
      }
      if (each) each();
    }
  }

  stream::test::ToyServer server_{9, 12'000};
  PageBoard board_{server_.stream, std::size_t{16} << 20};
  std::int64_t now_ns_ = kSecond;
};

}  // namespace splatbus::streamer
