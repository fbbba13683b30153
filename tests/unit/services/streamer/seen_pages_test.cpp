#include "streamer/seen_pages.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <numbers>
#include <random>
#include <vector>

#include "viewer_feed_fixture.h"

namespace splatbus::streamer {
namespace {

struct Rectangle {
  float x0_m, x1_m, y0_m, y1_m, z_m;
  float opacity_logit = 4;
};

/// Upright in front of the origin, each a page of its own.
GaussiansBuffer upright(const std::vector<Rectangle>& rectangles) {
  GaussiansBuffer model(ParameterLayout{}, rectangles.size() * kPageLanes);
  std::mt19937 random(3);
  const auto at = [&](int channel, std::size_t i) -> float& {
    return model.parameters[static_cast<std::size_t>(channel) * model.stride() + i];
  };
  for (std::size_t i = 0; i < model.count(); ++i) {
    const Rectangle& r = rectangles[i / kPageLanes];
    at(0, i) = std::uniform_real_distribution<float>(r.x0_m, r.x1_m)(random);
    at(1, i) = std::uniform_real_distribution<float>(r.y0_m, r.y1_m)(random);
    at(2, i) = r.z_m;
    for (int c = 0; c < 3; ++c) at(3 + c, i) = -4;
    at(6, i) = 1;
    at(10, i) = r.opacity_logit;
    model.normal[2 * model.stride() + i] = -1;
    model.visibility[i] = 1;
    model.gaussian_id[i] = i + 1;
  }
  return model;
}

/// From the origin along z: at a distance of 1 m 2 m of the width and 1 m of the height are seen.
Camera ahead() {
  Camera camera;
  camera.width = 200, camera.height = 100;
  camera.fx = camera.fy = 100;
  camera.cx = 100, camera.cy = 50;
  return camera;
}

const Rectangle kWallOnTheLeft{-2, 0, -1, 1, 2}, kBehindIt{-4, 0, -2, 2, 4}, kBesideThat{0, 4, -2, 2, 4};
constexpr float kHalf_px2 = 100 * 100;

class SeenPagesTest : public testing::Test {
 protected:
  std::vector<stream::OfferedPage> offered(const std::vector<Rectangle>& rectangles) {
    EXPECT_TRUE(model_.observe(upright(rectangles).view()));
    model_.reset_to_target();
    EXPECT_EQ(model_.offered()->size(), rectangles.size());
    return *model_.offered();
  }

  stream::StreamModel model_{stream::PacketWriter("streamer", 1), 1};
};

TEST_F(SeenPagesTest, DiscsAboutSurfelsHaveOneToTwoTimesTheAreaOfTheSurface) {
  const auto pages = offered({{-1, 1, -1.5F, 1.5F, 2}});
  const stream::PageSurfels& surfels = *pages[0].surfels;
  ASSERT_EQ(surfels.points_m.size(), stream::PageSurfels::kMost);
  const float area_m2 =
      std::numbers::pi_v<float> * surfels.radius_m * surfels.radius_m * static_cast<float>(surfels.points_m.size());
  EXPECT_GE(area_m2, 2 * 3);
  EXPECT_LE(area_m2, 2 * 2 * 3);
  for (const glm::vec3& point : surfels.points_m) {
    EXPECT_LE(std::abs(point.x), 1.01F);
    EXPECT_LE(std::abs(point.y), 1.51F);
    EXPECT_NEAR(point.z, 2, 0.01F);
  }
}

TEST_F(SeenPagesTest, WhatStandsBeforeAnotherPageHidesIt) {
  const auto pages = offered({kWallOnTheLeft, kBehindIt, kBesideThat});
  const auto areas_px2 = seen_areas_px2(pages, ahead(), {});
  EXPECT_NEAR(areas_px2.at(pages[0].page), kHalf_px2, 0.15F * kHalf_px2);
  EXPECT_LT(areas_px2.at(pages[1].page), 0.1F * kHalf_px2);
  EXPECT_NEAR(areas_px2.at(pages[2].page), kHalf_px2, 0.15F * kHalf_px2);
}

TEST_F(SeenPagesTest, WhatIsSeenThroughHidesNothing) {
  Rectangle glass = kWallOnTheLeft;
  glass.opacity_logit = -1;
  const auto pages = offered({glass, kBehindIt, kBesideThat});
  const auto areas_px2 = seen_areas_px2(pages, ahead(), {});
  EXPECT_FALSE(areas_px2.contains(pages[0].page)) << "nothing is known of it";
  EXPECT_NEAR(areas_px2.at(pages[1].page), kHalf_px2, 0.15F * kHalf_px2);
}

TEST_F(SeenPagesTest, AnObjectHidesWhereItIs) {
  auto pages = offered({kWallOnTheLeft, kBehindIt, kBesideThat});
  pages[0].object_id = 7;
  const auto where = [&](const ObjectTransforms& objects) { return seen_areas_px2(pages, ahead(), objects); };
  EXPECT_LT(where({{7, {}}}).at(pages[1].page), 0.1F * kHalf_px2);

  const auto aside = where({{7, Rigid{.rotation = {1, 0, 0, 0}, .translation = {2, 0, 0}}}});
  EXPECT_NEAR(aside.at(pages[1].page), kHalf_px2, 0.15F * kHalf_px2);
  EXPECT_LT(aside.at(pages[2].page), 0.1F * kHalf_px2);

  const auto absent = where({});
  EXPECT_FALSE(absent.contains(pages[0].page));
  EXPECT_NEAR(absent.at(pages[1].page), kHalf_px2, 0.15F * kHalf_px2);
}

TEST_F(SeenPagesTest, AViewerIsSentWhatShowsBeforeWhatIsHidden) {
  const Rectangle far_away{2, 8, -2, 2, 8};
  const auto pages = offered({kWallOnTheLeft, kBehindIt, far_away});
  ASSERT_GT(page_weight(pages[1], ViewerGaze{ahead(), ahead()}, {}),
            page_weight(pages[2], ViewerGaze{ahead(), ahead()}, {}));
  PageBoard board(model_, std::size_t{16} << 20);
  std::vector<stream::OfferedPage> changed;
  (void)board.add({}, changed);
  Seat seat(200);
  seat.gaze = ViewerGaze{ahead(), ahead()};
  seat.feed.begin({std::make_shared<WirePacket>(model_.layout_packet())});
  std::vector<std::uint32_t> order;
  for (std::int64_t now_ns = kSecond; now_ns < 10 * kSecond && order.size() < pages.size(); now_ns += kStep) {
    seat.read(model_, board, now_ns);
    seat.say(model_, now_ns);
    for (const auto& [page, held] : seat.replica.held().pages) {
      if (std::ranges::find(order, page) == order.end()) order.push_back(page);
    }
  }
  EXPECT_EQ(order, (std::vector<std::uint32_t>{pages[0].page, pages[2].page, pages[1].page}));
}

TEST_F(SeenPagesTest, AllWhoLookTakeAFifthOfACoreAtMost) {
  (void)offered({kWallOnTheLeft, kBehindIt, kBesideThat});
  PageBoard board(model_, std::size_t{16} << 20);
  std::vector<stream::OfferedPage> changed;
  (void)board.add({}, changed);
  EXPECT_TRUE(board.may_look(kSecond));
  EXPECT_FALSE(board.may_look(kSecond + 1));
  EXPECT_TRUE(board.may_look(2 * kSecond));
}

}  // namespace
}  // namespace splatbus::streamer
