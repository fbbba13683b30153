#include "trainer/shown_shares.h"

#include <numbers>

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
    view.camera = look_at({0, 0, distance_m}, {0, 0, 0}, 100, 100, 0.5F);
    ViewLook made{.view = std::make_shared<const TrainingView>(view), .loss = 0, .pages = {}};
    for (std::size_t p = 0; p < weights.size(); ++p) {
      made.pages.push_back({.page = pages_[p], .pairs = 5, .error = 0.1, .weight_px = weights[p]});
    }
    return made;
  }
  void see(const ViewLook& seen, int times = 1) {
    for (int k = 0; k < times; ++k) shares_.see(store(), std::span(&seen, 1));
  }
  /// Of the sphere about a page's bounds, from so far away that all of it is at one depth.
  [[nodiscard]] float area_px2(std::size_t p, float distance_m) {
    const PageBounds bounds = store().table().entry(pages_[p]).bounds;
    const glm::vec3 size(bounds.high.x - bounds.low.x, bounds.high.y - bounds.low.y, bounds.high.z - bounds.low.z);
    const float radius_m = 0.5F * glm::length(size) + bounds.max_scale_m;
    const float fx = look_at({0, 0, 1}, {0, 0, 0}, 100, 100, 0.5F).fx;
    return std::numbers::pi_v<float> * radius_m * radius_m * fx * fx / (distance_m * distance_m);
  }

  Trial trial_;
  ShownShares shares_;
  std::vector<std::uint32_t> pages_;
};

TEST_F(ShownSharesTest, AreOfThePlaceThatAPageTakesInThePictures) {
  ASSERT_GE(pages_.size(), 3U);
  EXPECT_EQ(share(0), 0) << "nobody has looked";
  see(look({-1, -1}, 100));
  EXPECT_EQ(share(0), 0) << "nobody has weighed it";
  const float half = 0.5F * area_px2(0, 100);
  see(look({half, 0}, 100));
  EXPECT_NEAR(share(0), 0.5F, 0.05F);
  EXPECT_GT(share(1), 0) << "it was looked for";
  EXPECT_LT(share(1), 1e-3F);
  EXPECT_LT(share(2), 1e-3F) << "what is behind something is in no look at all";
  // From four times as near a page is 16 times as large, and as much of it shows.
  see(look({16 * half, 0}, 25), 30);
  EXPECT_NEAR(share(0), 0.5F, 0.08F);
  // The wall goes.
  see(look({half, 0.8F * area_px2(1, 100)}, 100), 60);
  EXPECT_NEAR(share(1), 0.8F, 0.1F);
}

TEST_F(ShownSharesTest, WhatIsOutOfThePictureStaysAsItWas) {
  see(look({0.5F * area_px2(0, 100)}, 100));
  const float before = share(0);
  TrainingView away;
  away.camera = look_at({0, 0, 100}, {0, 0, 200}, 100, 100, 0.5F);
  ViewLook other = look({0, 0}, 100);
  other.view = std::make_shared<const TrainingView>(away);
  see(other, 10);
  EXPECT_EQ(share(0), before);
}

}  // namespace
}  // namespace splatbus::trainer
