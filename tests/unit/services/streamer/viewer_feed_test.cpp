// What one viewer is sent, and when.
#include <deque>

#include "viewer_feed_fixture.h"

namespace splatbus::streamer {
namespace {

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
  for (const double kbps : {100.0, 300.0, 1000.0, 4000.0}) {
    Seat seat(kbps);
    sit(seat);
    Seconds most;
    const double seconds = kbps < 500 ? 20 : 4;
    live({&seat}, seconds, 0.02F, [&] { most.add(seat.bytes); });
    EXPECT_LE(most.largest_kbps(), kbps * 1.1);
    EXPECT_GT(most.largest_kbps(), kbps * 0.8) << "the rate was not used";
    EXPECT_GT(static_cast<double>(seat.bytes), 0.6 * kbps * 125 * seconds) << kbps;
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

TEST_F(ViewerFeedTest, WhatIsOnItsWayIsNotSentAgainForWhatAViewerLackedBefore) {
  Seat seat(1e6);
  sit(seat);
  live({&seat}, 1, -1);
  const std::size_t pages = board_.offered().size();
  ASSERT_EQ(seat.feed.whole_pages(), pages);
  const std::uint64_t before = seat.feed.next_sequence() - 1;
  tick({&seat});
  seat.read(server_.stream, board_, now_ns_);
  ASSERT_EQ(seat.replica.held().find(0)->version, board_.find(0)->version) << "a delta has gone";
  const auto lacks_page_0 = [&](std::uint64_t newest) {
    (void)seat.feed.acknowledge({.newest = newest, .missing = {}, .lacks = {{0, 0}}, .dropped = {}}, server_.stream,
                                now_ns_ += kSecond);
    seat.read(server_.stream, board_, now_ns_);
  };
  lacks_page_0(before);
  EXPECT_EQ(seat.feed.refused_pages(), 0U);
  EXPECT_EQ(seat.feed.whole_pages(), pages);
  lacks_page_0(seat.feed.next_sequence() - 1);
  EXPECT_EQ(seat.feed.refused_pages(), 1U);
  EXPECT_EQ(seat.feed.whole_pages(), pages + 1);
}

TEST_F(ViewerFeedTest, WhatWasLostTakesNoRoomFromWhatComesAgain) {
  Seat seat(1e6, 12'100);
  sit(seat);
  seat.lost = wire::Body::Page;
  seat.lose = 3;
  live({&seat}, 2.1, -1);
  EXPECT_EQ(seat.feed.lost_packets(), 3U);
  EXPECT_EQ(seat.replica.count(), 12'000U);
  expect_exact(server_.stream, seat.replica);
}

TEST_F(ViewerFeedTest, WhatIsSaidOfLightsAfterLanesHaveChangedIsSaidOnce) {
  Seat seat(1e6);
  sit(seat);
  live({&seat}, 1, -1);
  server_.remove(100);
  tick({&seat}, 0);
  live({&seat}, 0.2, -1);
  std::set<std::uint32_t> others;
  for (const auto& [number, page] : seat.replica.held().pages) {
    if (page.structure == server_.stream.status().version) others.insert(number);
  }
  ASSERT_FALSE(others.empty()) << "no lanes have changed";
  std::vector<std::uint8_t> seen = server_.relit();
  for (std::uint8_t& value : seen) value = 255 - value;
  seat.sent.clear();
  std::ptrdiff_t packets = 0;
  for (auto& packet : server_.take_visibility(seen, server_.scene.version + 1)) {
    for (const wire::SeenPage& page : packet.pages) others.erase(page.page());
    seat.feed.push_visibility(std::make_shared<WirePacket>(packet.packet),
                              std::make_shared<const std::vector<wire::SeenPage>>(packet.pages));
    ++packets;
  }
  EXPECT_TRUE(others.empty()) << "nothing was said of some of them";
  live({&seat}, 0.5, 0);  // with ticks, so that it is planned anew
  live({&seat}, 0.2, -1);
  EXPECT_EQ(std::ranges::count(seat.sent, wire::Body::LightVisibility, &std::pair<wire::Body, std::size_t>::first),
            packets);
  expect_exact(server_.stream, seat.replica);
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
  EXPECT_GT(seat.replica.count(), kMost - 2UL * kPageLanes);
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
