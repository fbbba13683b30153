// What a board has of pages that other replicas encode.
#include "streamer/page_board.h"

#include "viewer_feed_fixture.h"

namespace splatbus::streamer {
namespace {

class PagesOfOthers : public testing::Test {
 protected:
  static constexpr std::uint32_t kPage = 3;

  explicit PagesOfOthers(Appearance appearance = Appearance::Transfer) : server_(9, 12'000, appearance) { offer(0); }

  /// The page's lanes became others so many versions later than they did.
  void offer(std::uint32_t later) {
    auto all = *server_.stream.offered();
    all.at(kPage).version += later;
    all.at(kPage).structure += later;
    std::vector<stream::OfferedPage> changed;
    (void)board_.add({}, {.all = std::make_shared<std::vector<stream::OfferedPage>>(all), .of_others = {kPage}},
                     changed);
    page_ = all.at(kPage);
  }
  [[nodiscard]] ShareAnswer answer(wire::SharePart part) {
    ShareAnswer answer{.what = {kPage, part}, .version = page_.version, .structure = page_.structure, .packets = {}};
    if (part == wire::SharePart::Visibility) {
      answer.packets = server_.stream.page_visibility(kPage);
    } else {
      for (auto& packet : server_.stream.page_packets(kPage, kPageLanes)) {
        answer.packets.push_back(std::move(packet.packet));
      }
    }
    return answer;
  }

  stream::test::ToyServer server_;
  PageBoard board_{server_.stream, std::size_t{16} << 20};
  stream::OfferedPage page_;
};

class RadianceOfOthers : public PagesOfOthers {
 protected:
  RadianceOfOthers() : PagesOfOthers(Appearance::Radiance) {}
};

TEST_F(PagesOfOthers, VisibilityOfLanesThatBecameOthersIsAskedForAnew) {
  EXPECT_TRUE(board_.page_visibility(kPage).empty());
  ASSERT_EQ(board_.take_wants(kSecond).size(), 1U);
  board_.take(answer(wire::SharePart::Visibility));
  EXPECT_FALSE(board_.page_visibility(kPage).empty());
  EXPECT_TRUE(board_.take_wants(2 * kSecond).empty());
  offer(1);
  EXPECT_TRUE(board_.page_visibility(kPage).empty());
  EXPECT_EQ(board_.take_wants(3 * kSecond).size(), 1U);
}

TEST_F(PagesOfOthers, WhatNobodyWantedIsNotTaken) {
  board_.take(answer(wire::SharePart::Whole));
  board_.take(answer(wire::SharePart::Visibility));
  EXPECT_FALSE(board_.page(kPage, false));
  EXPECT_TRUE(board_.page_visibility(kPage).empty());
  EXPECT_EQ(board_.take_wants(kSecond).size(), 2U);
  board_.take(answer(wire::SharePart::Whole));
  EXPECT_TRUE(board_.page(kPage, false));
}

TEST_F(RadianceOfOthers, NobodyAsksForVisibilityThatThereIsNone) {
  ViewerFeed feed(stream::kMaxGaussians);
  feed.rate().set(1e6, 0, 0);
  std::vector<stream::PageVersion> held;
  for (const stream::OfferedPage& page : board_.offered()) held.push_back({page.page, page.version});
  feed.resume(board_, held, false);
  for (std::int64_t now_ns = kSecond; now_ns < 2 * kSecond; now_ns += kSecond / 50) {
    while (feed.next(server_.stream, board_, std::nullopt, {}, now_ns)) feed.sent(now_ns);
    EXPECT_TRUE(board_.take_wants(now_ns).empty());
  }
  EXPECT_FALSE(feed.waits());
}

// Who says that it has lost its own, again and again, costs no encoding.
TEST_F(ViewerFeedTest, AManifestIsMadeOnceUntilSomethingChanges) {
  std::vector<stream::OfferedPage> changed;
  (void)board_.add({}, changed);
  const std::vector<SharedPacket> first = board_.manifest();
  EXPECT_EQ(board_.manifest(), first) << "the very packets";
  EXPECT_EQ(board_.layout(), board_.layout());
  const auto anew = server_.stream.manifest_packets(*server_.stream.offered(), {}, true);
  ASSERT_EQ(first.size(), anew.size());
  for (std::size_t k = 0; k < anew.size(); ++k) {
    const auto pages = [](const stream::EncodedPacket& packet) {
      std::vector<std::pair<std::uint32_t, std::uint32_t>> named;
      const auto parsed = stream::test::parse(packet);
      for (const wire::PageInfo* info : *parsed.root().body_as_Manifest()->pages()) {
        named.emplace_back(info->page(), info->version());
      }
      return named;
    };
    EXPECT_EQ(pages(first[k]->copy()), pages(anew[k]));
  }
  tick({});
  EXPECT_NE(board_.manifest(), first);
}

TEST_F(ViewerFeedTest, AManifestSaysTheBytesOfWhatIsEncoded) {
  const auto said = [&](std::uint32_t page) {
    const auto packets = server_.stream.manifest_packets(*server_.stream.offered(), {}, true);
    const auto parsed = stream::test::parse(packets[0]);
    for (const wire::PageInfo* info : *parsed.root().body_as_Manifest()->pages()) {
      if (info->page() == page) return info->bytes();
    }
    return 0U;
  };
  const auto whole = server_.stream.page_packets(1);
  ASSERT_EQ(whole.size(), 1U);
  EXPECT_EQ(said(1), stream::test::parse(whole[0].packet).root().body_as_Page()->blob_bytes());
  std::uint32_t in_parts = 0;
  for (const auto& part : server_.stream.page_packets(2, stream::kBlockRows)) {
    in_parts += stream::test::parse(part.packet).root().body_as_Page()->blob_bytes();
  }
  EXPECT_EQ(said(2), in_parts);
}

TEST_F(ViewerFeedTest, AsManyDeltasAreKeptAsThereIsRoomForThroughoutALongHistory) {
  constexpr std::size_t kRoom = std::size_t{1} << 18;
  PageBoard board(server_.stream, kRoom);
  std::set<std::uint32_t> pages;
  for (const stream::OfferedPage& page : *server_.stream.offered()) {
    (void)server_.stream.page_packets(page.page);
    pages.insert(page.page);
  }
  std::size_t all = 0, largest = 0;
  for (int tick = 0; all < 6 * kRoom; ++tick) {
    ASSERT_LT(tick, 200);
    server_.train(0.02F);
    ASSERT_TRUE(server_.stream.observe(server_.model().view()));
    server_.stream.set_holders(pages);
    server_.stream.make_tick(1e9, {});
    stream::StreamUpdate update = server_.stream.take_update();
    for (const auto& delta : update.deltas) {
      all += delta.packet.bytes();
      largest = std::max(largest, delta.packet.bytes());
    }
    std::vector<stream::OfferedPage> changed;
    (void)board.add(std::move(update), changed);
    std::size_t kept = 0;
    for (const SharedDelta& delta : board.deltas()) kept += delta.packet->bytes();
    EXPECT_LE(kept, kRoom);
    EXPECT_GE(kept, std::min(all, kRoom - largest)) << "after " << all << " bytes";
  }
  EXPECT_LT(4 * largest, kRoom);
}

// What is read by somebody who goes on with it by nothing is followed without a packet.
TEST_F(ViewerFeedTest, OfAPageThatWasOnlyReadNoDeltaIsMade) {
  std::vector<stream::OfferedPage> changed;
  (void)board_.add({}, changed);
  server_.stream.set_holders({});
  ASSERT_TRUE(board_.page(0, false, false));
  ASSERT_TRUE(board_.page(1, false));
  ASSERT_TRUE(board_.page(2, false, false));
  ASSERT_TRUE(board_.page(2, false)) << "that was read before";
  server_.train(0.2F);
  ASSERT_TRUE(server_.stream.observe(server_.model().view()));
  server_.stream.make_tick(1e9, {});
  std::set<std::uint32_t> pages;
  for (const auto& delta : server_.stream.take_update().deltas) {
    for (const auto& step : delta.steps) pages.insert(step.page);
  }
  EXPECT_EQ(pages, (std::set<std::uint32_t>{1, 2}));
}

}  // namespace
}  // namespace splatbus::streamer
