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

}  // namespace
}  // namespace splatbus::streamer
