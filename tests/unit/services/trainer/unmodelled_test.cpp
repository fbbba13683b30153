#include "trainer/unmodelled.h"

#include <gtest/gtest.h>

#include <cmath>

namespace splatbus::trainer {
namespace {

/// A picture of 32 x 24 in which all is surface, 2 m away, and modelled.
struct Scene {
  TrainingView view;
  raster::Image alpha{32, 24, 1};
  std::vector<float> depth = std::vector<float>(32 * 24, 2.0F);
  std::vector<std::uint8_t> own;
  std::vector<float> near_opacity;  // two samples of each of 4 x 3 squares

  Scene() {
    view.camera.width = 32;
    view.camera.height = 24;
    std::fill(alpha.data.begin(), alpha.data.end(), 0.97F);
  }
  void fill(std::vector<float>& of, std::uint32_t x0, std::uint32_t y0, std::uint32_t x1, std::uint32_t y1,
            float value) {
    for (std::uint32_t y = y0; y < y1; ++y) std::fill(of.begin() + y * 32 + x0, of.begin() + y * 32 + x1, value);
  }
  std::size_t mask(std::vector<std::uint8_t>& out) {
    view.depth = Pixels<float>(std::vector<float>(depth));
    if (!own.empty()) view.mask = Pixels<std::uint8_t>(std::vector<std::uint8_t>(own));
    return mask_unmodelled(alpha, view, 0.5F, near_opacity, out);
  }
};

TEST(Unmodelled, IsMaskedWhereASurfaceShowsAndNothingIsThere) {
  Scene scene;
  scene.fill(scene.alpha.data, 16, 0, 32, 24, 0.1F);
  scene.fill(scene.alpha.data, 20, 10, 21, 11, 0.8F);  // something
  std::vector<std::uint8_t> mask;
  EXPECT_EQ(scene.mask(mask), 16U * 24 - 1);
  for (std::uint32_t i = 0; i < mask.size(); ++i) {
    ASSERT_EQ(mask[i], i % 32 >= 16 && i != 10 * 32 + 20 ? 255 : 0) << i;
  }
}

TEST(Unmodelled, SkyIsNot) {
  Scene scene;
  scene.fill(scene.alpha.data, 0, 0, 32, 24, 0.1F);
  scene.fill(scene.depth, 0, 0, 32, 8, 0);
  scene.fill(scene.depth, 0, 8, 32, 12, INFINITY);
  std::vector<std::uint8_t> mask;
  EXPECT_EQ(scene.mask(mask), 32U * 12);
  for (std::uint32_t i = 0; i < mask.size(); ++i) ASSERT_EQ(mask[i], i < 12 * 32 ? 0 : 255);
}

TEST(Unmodelled, IsWhatLetsTheFarFieldThrough) {
  Scene scene;  // the far field is behind all of it, so that nothing is transparent
  scene.near_opacity.assign(24, 0.97F);
  scene.near_opacity[2 * 5] = 0.3F;
  scene.near_opacity[2 * 5 + 1] = 0.6F;
  scene.near_opacity[2 * 7] = 0.3F;
  scene.near_opacity[2 * 7 + 1] = 0.8F;
  scene.near_opacity[0] = scene.near_opacity[1] = 0;
  scene.fill(scene.depth, 0, 0, 8, 6, 0);  // sky at both samples
  std::vector<std::uint8_t> mask;
  EXPECT_EQ(scene.mask(mask), 64U);
  for (std::uint32_t i = 0; i < mask.size(); ++i) {
    const std::uint32_t x = i % 32, y = i / 32;
    ASSERT_EQ(mask[i], x >= 8 && x < 16 && y >= 8 && y < 16 ? 255 : 0) << i;
  }
}

TEST(Unmodelled, AHoleInWhatIsModelledIsNot) {
  Scene scene;
  scene.fill(scene.alpha.data, 9, 9, 14, 14, 0);  // 25 of a square's 64 pixels
  std::vector<std::uint8_t> mask;
  EXPECT_EQ(scene.mask(mask), 0U);
  scene.fill(scene.alpha.data, 8, 8, 16, 13, 0);  // 45
  EXPECT_GT(scene.mask(mask), 40U);
}

TEST(Unmodelled, ComesOnTopOfTheViewsOwnMask) {
  Scene scene;
  scene.own.assign(32 * 24, 0);
  for (std::size_t i = 0; i < 64; ++i) scene.own[i] = 255;
  scene.fill(scene.alpha.data, 0, 0, 8, 8, 0);
  std::vector<std::uint8_t> mask;
  EXPECT_EQ(scene.mask(mask), 8U * 8 - 16);
  EXPECT_EQ(mask[40], 255);
  EXPECT_EQ(mask[3 * 32 + 1], 255);
  EXPECT_EQ(mask[3 * 32 + 20], 0);
  scene.view.depth = {};
}

}  // namespace
}  // namespace splatbus::trainer
