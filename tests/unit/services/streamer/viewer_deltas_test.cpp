// What changes and pages come whole, as the rate of one viewer allows for.
#include "viewer_feed_fixture.h"

namespace splatbus::streamer {
namespace {

class ViewerDeltasTest : public ViewerFeedTest {};

TEST_F(ViewerDeltasTest, WhoIsTooSlowForTheDeltasIsSentFewerStatesRatherThanOldOnes) {
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

TEST_F(ViewerDeltasTest, DeltasAreMadeForPagesThatTheyBringUpToDate) {
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

TEST_F(ViewerDeltasTest, WhatItHasNoRoomForDoesNotHoldUpDeltas) {
  Seat small(20'000, 4000);
  sit(small);
  live({&small}, 4);
  ASSERT_LT(small.replica.held().pages.size(), board_.offered().size()) << "it has room for all";
  EXPECT_GT(small.feed.delta_bytes_per_s(), 0.5 * small.feed.rate().bytes_per_s());
}

TEST_F(ViewerDeltasTest, WhatItLacksComesBeforeWhatItHoldsChanges) {
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

TEST_F(ViewerDeltasTest, WhoWasAwayIsSentChangesOrPagesWhicheverIsLess) {
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

TEST_F(ViewerDeltasTest, ASlowViewerTakesNothingFromAnother) {
  const auto watch = [](bool with_slow) {
    ViewerDeltasTest_ASlowViewerTakesNothingFromAnother_Test other;
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

TEST_F(ViewerDeltasTest, ASlowViewerIsWholeWhenTheModelRests) {
  Seat slow(1000), fast(1e6);
  sit(slow);
  sit(fast);
  live({&slow, &fast}, 3);
  live({&slow, &fast}, 12, 0);
  expect_exact(server_.stream, slow.replica);
}

/// Of two pages, of which one has changed twice: the first time by little.
TEST_F(ViewerDeltasTest, WhatALargeChangeGoesOnFromGoesBeforeOtherPagesChanges) {
  std::vector<stream::OfferedPage> all(server_.stream.offered()->begin(), server_.stream.offered()->begin() + 2);
  all[1].bounds = all[0].bounds;  // as large in any picture
  stream::StreamUpdate update;
  std::vector<stream::PageVersion> held;
  const auto change = [&](std::size_t k, float steps) {
    stream::DeltaPacket delta;
    delta.packet = stream::PacketWriter("streamer", 1).write(76, 0, wire::Body::Keepalive, [](auto& builder) {
      return wire::CreateKeepalive(builder);
    });
    delta.packet.payload.resize(6000 + update.deltas.size());
    stream::OfferedPage& page = all[k];
    delta.steps.push_back({.page = page.page,
                           .base = page.page,
                           .from_version = page.version,
                           .version = page.version + 1,
                           .count = page.count,
                           .steps = steps});
    ++page.version;
    update.deltas.push_back(std::move(delta));
  };
  const auto offer = [&] {
    std::vector<stream::OfferedPage> changed;
    (void)board_.add(std::exchange(update, {}),
                     {.all = std::make_shared<const std::vector<stream::OfferedPage>>(all), .of_others = {}}, changed);
  };
  offer();
  for (const stream::OfferedPage& page : all) held.push_back({page.page, page.version});
  ViewerFeed feed(stream::kMaxGaussians);
  feed.rate().set(100, 0, 0);  // a plan is for two of the three
  feed.resume(board_, held, true);
  change(0, 0.01F);
  change(0, 1);
  change(1, 0.1F);
  offer();
  std::vector<std::size_t> sent, made;
  for (std::int64_t now_ns = kSecond; now_ns < 5 * kSecond; now_ns += kStep) {
    while (const SharedPacket packet = feed.next(server_.stream, board_, std::nullopt, {}, now_ns)) {
      feed.sent(now_ns);
      sent.push_back(packet->bytes());
    }
  }
  for (const SharedDelta& delta : board_.deltas()) made.push_back(delta.packet->bytes());
  ASSERT_EQ(made.size(), 3U);
  EXPECT_EQ(sent, made);
}

TEST_F(ViewerDeltasTest, DeltasThatWaitGoOutInTheOrderInWhichTheyWereMade) {
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

}  // namespace
}  // namespace splatbus::streamer
