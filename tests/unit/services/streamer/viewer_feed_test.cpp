// What one viewer is sent, and when.
#include "streamer/viewer_feed.h"

#include <gtest/gtest.h>

#include <deque>

#include "../../stream/expectations.h"
#include "../../stream/toy_server.h"

namespace splatbus::streamer {
namespace {

using stream::test::expect_exact;

constexpr std::int64_t kSecond = 1'000'000'000, kTick = kSecond / 5, kStep = kSecond / 100;

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

/// The most bytes of any second, read every kStep.
class Seconds {
 public:
  void add(std::uint64_t bytes) {
    window_.push_back(bytes);
    if (window_.size() <= 100) return;
    largest_ = std::max(largest_, window_.back() - window_.front());
    window_.pop_front();
  }
  [[nodiscard]] double largest_kbps() const { return static_cast<double>(largest_) / 125; }

 private:
  std::deque<std::uint64_t> window_;
  std::uint64_t largest_ = 0;
};

TEST_F(ViewerFeedTest, NoSecondHasMoreThanATenthAboveTheRate) {
  for (const double kbps : {1000.0, 4000.0}) {
    Seat seat(kbps);
    sit(seat);
    Seconds most;
    live({&seat}, 4, 0.02F, [&] { most.add(seat.bytes); });
    EXPECT_LE(most.largest_kbps(), kbps * 1.1);
    EXPECT_GT(most.largest_kbps(), kbps * 0.8) << "the rate was not used";
  }
}

TEST_F(ViewerFeedTest, ARateThatIsChangedHoldsFromThenOn) {
  Seat seat(4000);
  sit(seat);
  live({&seat}, 1);
  const auto most_in = [&](double seconds) {
    live({&seat}, 0.2);  // what was allowed before has gone
    Seconds most;
    live({&seat}, seconds, 0.02F, [&] { most.add(seat.bytes); });
    return most.largest_kbps();
  };
  seat.feed.rate().set(1500, 0, now_ns_);
  double most = most_in(2.5);
  EXPECT_LE(most, 1500 * 1.1);
  EXPECT_GT(most, 1500 * 0.8);
  // What the viewer itself wants bounds that, and no more than that.
  seat.feed.rate().set(1500, 700, now_ns_);
  most = most_in(2.5);
  EXPECT_LE(most, 700 * 1.1);
  EXPECT_GT(most, 700 * 0.8);
  seat.feed.rate().set(1500, 9000, now_ns_);
  most = most_in(2.5);
  EXPECT_LE(most, 1500 * 1.1);
  EXPECT_GT(most, 1500 * 0.8);
}

TEST_F(ViewerFeedTest, WhoIsTooSlowForTheDeltasIsSentFewerStatesRatherThanOldOnes) {
  Seat slow(1000), fast(1e6);
  sit(slow);
  sit(fast);
  live({&slow, &fast}, 4);  // until it holds all of them
  ASSERT_EQ(slow.replica.held().pages.size(), board_.offered().size());
  // When each version was new.
  std::map<std::uint32_t, std::int64_t> since;
  const std::uint64_t bytes = fast.bytes;
  live({&slow, &fast}, 8, 0.02F, [&] { since.emplace(server_.stream.status().version, now_ns_); });
  ASSERT_GT(static_cast<double>(fast.bytes - bytes), 4 * 8 * 125'000.0) << "the deltas are no burden";
  for (const auto& [number, page] : slow.replica.held().pages) {
    const auto newer = since.upper_bound(page.version);
    const double age_s = newer != since.end() ? static_cast<double>(now_ns_ - newer->second) * 1e-9 : 0;
    // All pages take two to three seconds of its rate.
    EXPECT_LT(age_s, 5) << "page " << number;
  }
}

TEST_F(ViewerFeedTest, DeltasAreMadeForPagesThatTheyBringUpToDate) {
  Seat slow(1000);
  sit(slow);
  const double rate = slow.feed.rate().bytes_per_s();
  const auto followed = [&] {
    std::set<std::uint32_t> pages;
    slow.feed.follow_pages(pages);
    return pages;
  };
  EXPECT_LT(slow.feed.delta_bytes_per_s(), 0.2 * rate) << "it holds nothing yet";
  // Each tick changes all pages by more than the rate has: of most of them only the whole page is of use.
  std::size_t left = 0, least = board_.offered().size();
  live({&slow}, 6, 0.02F, [&] {
    const std::set<std::uint32_t> pages = followed();
    for (const auto& [page, record] : slow.replica.held().pages) left += pages.contains(page) ? 0 : 1;
    if (slow.replica.held().pages.size() == board_.offered().size()) least = std::min(least, pages.size());
  });
  EXPECT_GT(left, 0U);
  EXPECT_LT(least, board_.offered().size() / 2);
  EXPECT_LT(slow.feed.delta_bytes_per_s(), 0.2 * rate);
  // Nothing changes any more: what it was left with comes whole, and is followed again.
  live({&slow}, 6, 0);
  EXPECT_EQ(followed().size(), board_.offered().size());
  EXPECT_GT(slow.feed.delta_bytes_per_s(), 0.5 * rate);
  for (const stream::OfferedPage& page : board_.offered()) {
    EXPECT_EQ(slow.replica.held().pages.at(page.page).version, page.version);
  }
}

TEST_F(ViewerFeedTest, WhatItHasNoRoomForDoesNotHoldUpDeltas) {
  Seat small(20'000, 4000);
  sit(small);
  live({&small}, 4);
  ASSERT_LT(small.replica.held().pages.size(), board_.offered().size()) << "it has room for all";
  EXPECT_GT(small.feed.delta_bytes_per_s(), 0.5 * small.feed.rate().bytes_per_s());
}

TEST_F(ViewerFeedTest, WhatItLacksComesBeforeWhatItHoldsChanges) {
  Seat fast(1e6), joins(2000);
  sit(fast);
  live({&fast}, 1);
  std::uint64_t bytes = 0;
  for (const auto& [body, size] : fast.sent) bytes += body == wire::Body::Page ? size : 0;
  // All pages change with every tick, by more bytes than the rate has.
  sit(joins);
  const std::int64_t begin_ns = now_ns_;
  std::optional<std::int64_t> whole_ns;
  live({&fast, &joins}, 12, 0.02F, [&] {
    if (!whole_ns && joins.replica.held().pages.size() == board_.offered().size()) whole_ns = now_ns_;
  });
  ASSERT_TRUE(whole_ns);
  EXPECT_LE(static_cast<double>(*whole_ns - begin_ns) * 1e-9, 1.6 * static_cast<double>(bytes) / 250'000)
      << "as if there were no changes, and a half";
}

TEST_F(ViewerFeedTest, WhoWasAwayIsSentChangesOrPagesWhicheverIsLess) {
  for (const int ticks : {3, 40}) {
    Seat away(1e6), stays(1e6);
    sit(away);
    sit(stays);
    live({&away, &stays}, 2);
    live({&away, &stays}, 0.2, -1);
    // Its pages change a little with each tick while it is away.
    std::uint64_t pages = 0, changes = 0;
    for (const auto& [body, size] : stays.sent) pages += body == wire::Body::Page ? size : 0;
    const std::size_t before = stays.sent.size();
    for (int k = 0; k < ticks; ++k) live({&stays}, 0.2);
    live({&stays}, 0.2, -1);
    for (std::size_t k = before; k < stays.sent.size(); ++k) changes += stays.sent[k].second;
    const std::uint64_t bytes = away.bytes;
    live({&away, &stays}, 1, -1);
    expect_exact(server_.stream, away.replica);
    EXPECT_LE(static_cast<double>(away.bytes - bytes), 1.3 * static_cast<double>(std::min(pages, changes)))
        << ticks << " ticks: all pages have " << pages << " bytes, the changes " << changes;
  }
}

TEST_F(ViewerFeedTest, WhatAViewerHoldsIsWhatIsOffered) {
  Seat seat(1e6);
  sit(seat);
  live({&seat}, 3);
  live({&seat}, 0.2, -1);
  expect_exact(server_.stream, seat.replica);
  stream::test::expect_shown(seat.replica);
  // The pages came once, and everything after that as deltas.
  EXPECT_EQ(seat.feed.whole_pages(), board_.offered().size());
}

TEST_F(ViewerFeedTest, ASlowViewerTakesNothingFromAnother) {
  const auto watch = [](bool with_slow) {
    ViewerFeedTest_ASlowViewerTakesNothingFromAnother_Test other;
    Seat fast(1e6), slow(1000);
    other.sit(fast);
    other.sit(slow);
    std::vector<Seat*> seats{&fast};
    if (with_slow) seats.push_back(&slow);
    other.live(seats, 4);
    if (with_slow) {
      EXPECT_GT(slow.replica.count(), 0U);
      EXPECT_LT(slow.bytes, fast.bytes);
      EXPECT_LE(slow.bytes, 125'000U * 4 + 12'500);
    }
    return fast.sent;
  };
  EXPECT_EQ(watch(false), watch(true));
}

TEST_F(ViewerFeedTest, ASlowViewerIsWholeWhenTheModelRests) {
  Seat slow(1000), fast(1e6);
  sit(slow);
  sit(fast);
  live({&slow, &fast}, 3);
  live({&slow, &fast}, 12, 0);
  expect_exact(server_.stream, slow.replica);
}

TEST_F(ViewerFeedTest, ALostPacketMakesItsPagesComeAgain) {
  Seat seat(1e6), good(1e6);
  sit(seat);
  sit(good);
  seat.lost = wire::Body::Page;
  seat.lose = 2;
  live({&seat, &good}, 1);
  seat.lost = wire::Body::PageDelta;
  seat.lose = 3;
  live({&seat, &good}, 2);
  live({&seat, &good}, 1, 0);
  live({&seat, &good}, 0.4, -1);
  EXPECT_EQ(seat.lose, 0);
  EXPECT_EQ(seat.feed.lost_packets(), 5U);
  EXPECT_EQ(good.feed.lost_packets(), 0U);
  expect_exact(server_.stream, seat.replica);
}

TEST_F(ViewerFeedTest, WhatIsLostOfPagesThatEndIsToldAgain) {
  Seat seat(1e6);
  sit(seat);
  live({&seat}, 1, 0);
  const std::size_t pages = seat.replica.held().pages.size();
  seat.lost = wire::Body::PagesGone;
  seat.lose = 1;
  server_.remove(2000);
  live({&seat}, 1, 0);
  EXPECT_EQ(seat.lose, 0);
  EXPECT_EQ(seat.feed.lost_packets(), 1U);
  EXPECT_LT(seat.replica.held().pages.size(), pages);
  expect_exact(server_.stream, seat.replica);
}

TEST_F(ViewerFeedTest, APacketIsLostOnceHoweverOftenAViewerSaysSo) {
  Seat seat(1e6);
  sit(seat);
  seat.read(server_.stream, board_, now_ns_);
  const ViewerFeed::Said said{.newest = 0, .missing = {{1, 1}}, .lacks = {}, .dropped = {}};
  EXPECT_TRUE(seat.feed.acknowledge(said, server_.stream, now_ns_)) << "the Layout";
  EXPECT_FALSE(seat.feed.acknowledge(said, server_.stream, now_ns_));
  EXPECT_EQ(seat.feed.lost_packets(), 1U);
}

TEST_F(ViewerFeedTest, WhoComesBackIsSentWhatHasChanged) {
  Seat before(1e6), stays(1e6);
  sit(before);
  sit(stays);
  live({&before, &stays}, 2);
  live({&before, &stays}, 6, 0);
  expect_exact(server_.stream, before.replica);
  const auto held = before.replica.held_pages();
  // Two pages change while it is away.
  const std::uint32_t first = server_.stream.held().find(3)->version;
  for (std::size_t i = 0; i < std::size_t{2} * kPageLanes; ++i) server_.model().parameters[i] += 0.5F;
  tick({&stays}, 0);
  ASSERT_EQ(server_.stream.held().find(3)->version, first);
  board_.clear();
  std::vector<stream::OfferedPage> changed;
  (void)board_.add({}, changed);
  before.feed.resume(board_, held, true);
  const std::uint64_t bytes = before.bytes;
  before.read(server_.stream, board_, now_ns_ += kSecond);
  expect_exact(server_.stream, before.replica);
  EXPECT_EQ(before.feed.whole_pages(), board_.offered().size() + 2) << "two pages that have changed, and no others";
  EXPECT_LT(before.bytes - bytes, 80'000U);
}

TEST_F(ViewerFeedTest, PagesInViewComeFirst) {
  Seat seat(2000);
  GazeTracker tracker;
  const Camera camera = look_at({-2, 1, -2}, {-2.2F, 0, -2.2F}, 64, 64, 0.6F);
  tracker.add(camera, now_ns_);
  seat.gaze = tracker.gaze();
  sit(seat);
  std::vector<std::uint32_t> order;
  float in_first_half = 0, in_second = 0;
  live({&seat}, 3, -1, [&] {
    for (const auto& [page, held] : seat.replica.held().pages) {
      if (std::ranges::find(order, page) == order.end()) order.push_back(page);
    }
  });
  ASSERT_EQ(order.size(), board_.offered().size());
  for (std::size_t k = 0; k < order.size(); ++k) {
    (k < order.size() / 2 ? in_first_half : in_second) += page_weight(*board_.find(order[k]), seat.gaze, {});
  }
  EXPECT_GE(in_first_half, in_second);
}

TEST_F(ViewerFeedTest, WithinItsMemoryAViewerHoldsWhatItSees) {
  constexpr std::size_t kMost = 4096;
  Seat seat(1e6, kMost);
  sit(seat);
  live({&seat}, 1, -1);
  EXPECT_LE(seat.replica.count(), kMost);
  EXPECT_GT(seat.replica.count(), kMost - kPageLanes);
  EXPECT_EQ(seat.feed.refused_pages(), 0U) << "it was sent what it has no room for";
}

TEST_F(ViewerFeedTest, DeltasThatWaitGoOutInTheOrderInWhichTheyWereMade) {
  Seat seat(1e6);
  sit(seat);
  live({&seat}, 1, -1);
  const std::uint64_t whole = seat.feed.whole_pages();
  tick({&seat}, 0.01F);
  tick({&seat}, 0.05F);  // changes more, and is worth more
  live({&seat}, 0.1, -1);
  expect_exact(server_.stream, seat.replica);
  EXPECT_EQ(seat.feed.whole_pages(), whole);
}

TEST_F(ViewerFeedTest, WithinItsMemoryItStaysWhenGaussiansOfItsPagesComeAndGo) {
  constexpr std::size_t kMost = 4096;
  Seat seat(1e6, kMost);
  sit(seat);
  live({&seat}, 1, -1);
  for (int round = 0; round < 5; ++round) {
    server_.remove(100);
    live({&seat}, 0.4, 0);
    server_.insert(100);
    live({&seat}, 0.4, 0);
    EXPECT_LE(seat.replica.count(), kMost);
    EXPECT_EQ(seat.feed.refused_pages(), 0U) << "it was sent what it has no room for";
  }
  EXPECT_GT(seat.replica.count(), kMost - 2 * kPageLanes);
}

// As long as it does not acknowledge, or its rate lets nothing through.
TEST_F(ViewerFeedTest, OfWhatWaitsForAViewerLittleIsKept) {
  Seat seat(1e6);
  sit(seat);
  live({&seat}, 1, -1);
  const auto one_manifest = server_.stream.manifest_packets(*server_.stream.offered(), {}, false);
  ASSERT_EQ(one_manifest.size(), 1U);
  const auto news = std::make_shared<WirePacket>(one_manifest.front());
  const auto visibility = std::make_shared<WirePacket>(
      stream::PacketWriter("streamer", 1).write(76, 0, wire::Body::Keepalive, [](auto& builder) {
        return wire::CreateKeepalive(builder);
      }));
  const auto seen = std::make_shared<const std::vector<wire::SeenPage>>();
  for (int k = 0; k < 1000; ++k) {
    seat.feed.push_news(news);
    seat.feed.push_visibility(visibility, seen);
  }
  EXPECT_LE(news.use_count(), 65);
  EXPECT_LE(visibility.use_count(), 65);
  // What many had said one says, the whole.
  seat.sent.clear();
  live({&seat}, 0.2, -1);
  EXPECT_EQ(std::ranges::count(seat.sent, wire::Body::Manifest, &std::pair<wire::Body, std::size_t>::first), 1);
  seat.sent.clear();
  seat.feed.push_news(news);
  live({&seat}, 0.2, -1);
  EXPECT_EQ(std::ranges::count(seat.sent, wire::Body::Manifest, &std::pair<wire::Body, std::size_t>::first), 1);
}

}  // namespace
}  // namespace splatbus::streamer
