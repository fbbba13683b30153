#include "relight/filter.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <vector>

namespace splatbus::relight {
namespace {

constexpr int kWidth = 45, kHeight = 31;

/// By the definition, texel by texel.
double expected_share(Projection projection, const FilterWindow& w, const std::vector<float>& depth_m) {
  const bool pinhole = projection == Projection::Pinhole;
  double lit = 0, all = 0;
  for (int y = -100; y < 200; ++y) {
    for (int x = -100; x < 200; ++x) {
      const double dx = x + 0.5 - w.x, dy = y + 0.5 - w.y;
      const double share = std::max(0.0, 1 - dx * dx / (w.radius_x * w.radius_x) - dy * dy / (w.radius_y * w.radius_y));
      const bool inside = x >= 0 && x < kWidth && y >= 0 && y < kHeight;
      const double plane = w.plane + w.slope_x * dx + w.slope_y * dy;
      const double plane_m = pinhole ? 1 / plane : plane;
      if (pinhole && !inside) continue;
      all += share;
      if (!inside || plane_m <= depth_m[static_cast<std::size_t>(y) * kWidth + x]) lit += share;
    }
  }
  return lit / all;
}

class Filter : public testing::TestWithParam<Projection> {};

TEST_P(Filter, WeighsEveryTexelAlsoAtTheMapsBorders) {
  const bool pinhole = GetParam() == Projection::Pinhole;
  std::mt19937 random(4);
  const auto uniform = [&](float low, float high) { return std::uniform_real_distribution<float>(low, high)(random); };
  std::vector<float> depth_m(std::size_t{kWidth} * kHeight);
  for (float& depth : depth_m) depth = uniform(5, 6);
  int partly = 0;
  for (int k = 0; k < 500; ++k) {
    const float steepest = pinhole ? 0.003F : 0.2F;
    FilterWindow w{.plane = pinhole ? 1 / uniform(5, 6) : uniform(5, 6),
                   .slope_x = uniform(-steepest, steepest),
                   .slope_y = uniform(-steepest, steepest)};
    w.radius_x = uniform(kMinRadius_texels, kMaxRadius_texels);
    w.radius_y = uniform(kMinRadius_texels, kMaxRadius_texels);
    const float beyond = pinhole ? 0.0F : 1.0F;  // of a pinhole's map something has to be seen
    w.x = uniform(-w.radius_x * beyond, kWidth + w.radius_x * beyond);
    w.y = uniform(-w.radius_y * beyond, kHeight + w.radius_y * beyond);
    const double expected = expected_share(GetParam(), w, depth_m);
    ASSERT_NEAR(lit_share(GetParam(), w, depth_m.data(), kWidth, kHeight), expected, 2e-3) << w.x << ", " << w.y;
    ASSERT_NEAR(lit_share_on_host(GetParam(), w, depth_m.data(), kWidth, kHeight), expected, 2e-3)
        << w.x << ", " << w.y;
    partly += expected > 0.1 && expected < 0.9 ? 1 : 0;
  }
  EXPECT_GT(partly, 200);
}

INSTANTIATE_TEST_SUITE_P(Projections, Filter, testing::Values(Projection::Orthographic, Projection::Pinhole));

}  // namespace
}  // namespace splatbus::relight
