#include "viewer/camera_path.h"

#include <gtest/gtest.h>

namespace splatbus::viewer {
namespace {

TEST(CameraPath, OrbitReturnsAfterOnePeriodAndLooksAtTheTarget) {
  bus::Parameters p(path_parameter_specs());
  ASSERT_EQ(p.set("period_s", "8", false), "");
  ASSERT_EQ(p.set("radius_m", "3", false), "");
  ASSERT_EQ(p.set("target_x_m", "1", false), "");
  ASSERT_EQ(p.set("target_y_m", "0.5", false), "");
  for (const double t : {0.0, 1.0, 3.5}) {
    const Camera a = path_camera(p, t), b = path_camera(p, t + 8);
    EXPECT_LT(glm::length(a.world_from_camera.translation - b.world_from_camera.translation), 1e-3F);
    const glm::vec3 pixel = project(a, {1, 0.5F, 0});
    EXPECT_NEAR(pixel.x, a.cx, 0.01F);
    EXPECT_NEAR(pixel.y, a.cy, 0.01F);
    EXPECT_GT(pixel.z, 0);
  }
  EXPECT_GT(
      glm::length(path_camera(p, 0).world_from_camera.translation - path_camera(p, 4).world_from_camera.translation),
      5.9F);
}

TEST(CameraPath, StillStays) {
  bus::Parameters p(path_parameter_specs());
  ASSERT_EQ(p.set("path", "still", false), "");
  EXPECT_EQ(path_camera(p, 0).world_from_camera.translation, path_camera(p, 5).world_from_camera.translation);
}

}  // namespace
}  // namespace splatbus::viewer
