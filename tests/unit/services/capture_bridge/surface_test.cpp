#include <gtest/gtest.h>

#include <algorithm>
#include <limits>

#include "sampled_views.h"

namespace splatbus::capture_bridge::test {
namespace {

TEST(Footprint, OfAFloorSeenFromAboveIsItsPixel) {
  const Camera camera = look_at({0, 2, 0}, {0, 0, 0}, 64, 64, 1);
  const AnalyticScene scene{.ball_centre = {9, 9, 9}, .sheet_centre = {9, 9, 9}};
  const InputView view = scene.render(camera);
  const ViewSurface surface = analyse_surface(view);
  for (std::size_t i = 0; i < view.pixels(); ++i) {
    ASSERT_NEAR(surface.footprint_m[i], 2 / camera.fx, 1e-4F);
    ASSERT_NEAR(surface.depth_m[i], 2, 1e-4F);
  }
  EXPECT_EQ(surface.dropped.broken(), 0U);
}

TEST(Footprint, IsTheRootOfThePixelsAreaWhenTheFloorIsSeenObliquely) {
  const Camera camera = look_at({0, 1, 3}, {0, 0, 0}, 64, 64, 0.6F);
  const AnalyticScene scene{.ball_centre = {9, 9, 9}, .sheet_centre = {9, 9, 9}};
  const ViewSurface surface = analyse_surface(scene.render(camera));
  const std::size_t middle = 32 * 64 + 32;
  const float depth = surface.depth_m[middle];
  const float expected = depth / camera.fx / std::sqrt(surface.cosine[middle]);
  EXPECT_NEAR(surface.footprint_m[middle], expected, 0.03F * expected);
}

TEST(Footprint, DoesNotLeapOverDiscontinuities) {
  const AnalyticScene scene;
  const Camera camera = look_at({0, 1.5F, 3}, {0, 0.4F, 0}, 96, 96, 1);
  const ViewSurface surface = analyse_surface(scene.render(camera));
  std::size_t edges = 0;
  for (std::size_t i = 0; i < surface.footprint_m.size(); ++i) {
    if (surface.footprint_m[i] == 0) continue;
    edges += surface.edge[i] ? 1 : 0;
    // Never more than the tangent plane allows, with room for the ball's curvature within a pixel.
    EXPECT_LT(surface.footprint_m[i], 2 * surface.depth_m[i] / camera.fx / std::sqrt(surface.cosine[i]));
  }
  EXPECT_GT(edges, 50U);
}

TEST(Surface, DropsAndCountsGarbage) {
  const AnalyticScene scene;
  InputView view = scene.render(look_at({0, 2, 0.01F}, {0, 0, 0}, 32, 32, 1));
  const float nan = std::numeric_limits<float>::quiet_NaN();
  view.position[0].x = nan;
  view.position[1].z = std::numeric_limits<float>::infinity();
  view.position[2].w = nan;  // means nothing
  view.object_id[9] = 0;
  view.normal[3].y = nan;
  view.normal[4] = glm::vec4(0, 3, 0, 0);
  view.position[5] += glm::vec4(5, 0, 0, 0);
  view.normal[6] = -view.normal[6];
  view.normal[7] = glm::vec4(0);
  view.position[8] = glm::vec4(1e30F, 1e30F, 1e30F, 1);
  const ViewSurface surface = analyse_surface(view);
  for (const std::size_t i : {0, 1, 3, 4, 5, 6, 7, 8, 9}) EXPECT_EQ(surface.footprint_m[i], 0) << i;
  EXPECT_GT(surface.footprint_m[2], 0);
  EXPECT_EQ(surface.dropped.not_finite, 3U);
  EXPECT_EQ(surface.dropped.bad_normal, 2U);
  EXPECT_EQ(surface.dropped.off_ray, 2U);
  EXPECT_TRUE(
      std::all_of(surface.footprint_m.begin(), surface.footprint_m.end(), [](float f) { return std::isfinite(f); }));
}

}  // namespace
}  // namespace splatbus::capture_bridge::test
