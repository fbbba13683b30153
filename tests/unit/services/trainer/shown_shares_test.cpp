#include "trainer/shown_shares.h"

#include <numbers>

#include "../../model/device_test.h"
#include "optimizer_fixture.h"

namespace splatbus::trainer {
namespace {

class SharesTest : public OptimizerTest {
 protected:
  SharesTest() { scene_ = SyntheticScene(3000, 4, 32); }
};

class ShownSharesTest : public SharesTest {
 protected:
  ShownSharesTest() : trial_(OptimizerTest::trial(Device::Cpu, {}, 8192)) {
    for (const IndexRange& range : store().view().ranges) pages_.push_back(range.first / kPageLanes);
  }
  model::PageStore& store() { return trial_.store(); }
  [[nodiscard]] float share(std::size_t p) { return store().table().entry(pages_[p]).shown_share; }

  /// A view from so far away on the z axis that shows so many pixels of the pages, and nothing of those after.
  ViewLook look(const std::vector<float>& weights, float distance_m) {
    TrainingView view;
    view.camera = look_at({0, 0, distance_m}, {0, 0, 0}, 400, 400, 0.5F);
    ViewLook made{.view = std::make_shared<const TrainingView>(view), .loss = 0, .pages = {}, .active_share = {}};
    for (std::size_t p = 0; p < weights.size(); ++p) {
      if (weights[p] > 0) made.pages.push_back({.page = pages_[p], .weight_px = weights[p], .error = 0.1});
    }
    return made;
  }
  void seconds(const ViewLook& seen, int count) {
    for (int k = 0; k < count; ++k) {
      shares_.see(store(), std::span(&seen, 1));
      store().add_time(1);
    }
  }
  /// Of the sphere about a page's bounds, from so far away that all of it is at one depth.
  [[nodiscard]] float area_px2(std::size_t p, float distance_m) {
    const PageBounds bounds = store().table().entry(pages_[p]).bounds;
    const glm::vec3 size(bounds.high.x - bounds.low.x, bounds.high.y - bounds.low.y, bounds.high.z - bounds.low.z);
    const float radius_m = 0.5F * glm::length(size) + bounds.max_scale_m;
    const float fx = look_at({0, 0, 1}, {0, 0, 0}, 400, 400, 0.5F).fx;
    return std::numbers::pi_v<float> * radius_m * radius_m * fx * fx / (distance_m * distance_m);
  }

  Trial trial_;
  ShownShares shares_;
  std::vector<std::uint32_t> pages_;
};

TEST_F(ShownSharesTest, AreOfThePlaceThatAPageTakesInThePictures) {
  ASSERT_GE(pages_.size(), 3U);
  EXPECT_EQ(share(0), 0) << "nobody has looked";
  const float half = 0.5F * area_px2(0, 100);
  ASSERT_GT(half, 100);
  seconds(look({half}, 100), 1);
  EXPECT_NEAR(share(0), 0.5F, 0.05F);
  EXPECT_GT(share(1), 0) << "it was looked for";
  EXPECT_LT(share(1), 1e-3F) << "what is behind something is in no look at all";
  // From four times as near a page is 16 times as large, and as much of it shows.
  seconds(look({16 * half}, 25), 3);
  EXPECT_NEAR(share(0), 0.5F, 0.08F);
}

TEST_F(ShownSharesTest, TheLargestCountsAndFadesWhereThePlaceStaysInThePicture) {
  const float area = area_px2(0, 100);
  const std::vector<ViewLook> both{look({0.6F * area}, 100), look({0.1F * area}, 100)};
  shares_.see(store(), both);
  shares_.see(store(), std::span(both).last(1));
  store().add_time(1);
  EXPECT_NEAR(share(0), 0.6F, 0.06F);
  // It is hidden from now on, and page 1 no longer is.
  const ViewLook other = look({0, 0.7F * area_px2(1, 100)}, 100);
  seconds(other, 3);
  EXPECT_LT(share(0), 0.5F);
  EXPECT_GT(share(0), 0.1F);
  EXPECT_NEAR(share(1), 0.7F, 0.07F);
  seconds(other, 40);
  EXPECT_GT(share(0), 0);
  EXPECT_LT(share(0), 1e-3F);
}

TEST_F(ShownSharesTest, WhatIsOutOfThePictureStaysAsItWas) {
  seconds(look({0.5F * area_px2(0, 100)}, 100), 1);
  const float before = share(0);
  TrainingView away;
  away.camera = look_at({0, 0, 100}, {0, 0, 200}, 400, 400, 0.5F);
  ViewLook other = look({0, 9}, 100);
  other.view = std::make_shared<const TrainingView>(away);
  seconds(other, 10);
  EXPECT_EQ(share(0), before);
}

TEST_F(ShownSharesTest, WhoeverTakesAPagesBlockBeginsWithoutItsShare) {
  seconds(look({0.5F * area_px2(0, 100)}, 100), 1);
  ASSERT_GT(share(0), 0.4F);
  store().table().entry(pages_[0]).now.morton_first += 1;
  TrainingView away;
  away.camera = look_at({0, 0, 100}, {0, 0, 200}, 400, 400, 0.5F);
  ViewLook other = look({0, 9}, 100);
  other.view = std::make_shared<const TrainingView>(away);
  seconds(other, 1);
  EXPECT_EQ(share(0), 0);
}

/// On either device.
class SharesOn : public SharesTest, public testing::WithParamInterface<Device> {
 protected:
  void SetUp() override {
    if (!has_device(GetParam())) GTEST_SKIP() << "no CUDA device";
  }
};

TEST_P(SharesOn, TrainingSaysThemInThePageTable) {
  Trial s = OptimizerTest::trial(GetParam(), {{"freeze", "true"}, {"freeze_after_s", "3600"}}, 8192);
  s.train(32);
  for (const IndexRange& range : s.store().view().ranges) {
    const float share = s.store().table().entry(range.first / kPageLanes).shown_share;
    EXPECT_GT(share, 0.01F) << "nothing hides the floor";
    EXPECT_LE(share, 1);
  }
}

INSTANTIATE_TEST_SUITE_P(Devices, SharesOn, testing::Values(Device::Cpu, Device::Cuda), model::device_name);

}  // namespace
}  // namespace splatbus::trainer
