#include "viewer/camera_path.h"

#include <gtest/gtest.h>

namespace splatbus::viewer {
namespace {

TEST(CameraPath, OrbitReturnsAfterOnePeriodAndLooksAtTheTarget) {
  CameraPath path;
  path.period_s = 8;
  path.radius_m = 3;
  path.target_m = {1, 0.5F, 0};
  for (const double t : {0.0, 1.0, 3.5}) {
    const Camera a = path.at(t), b = path.at(t + 8);
    EXPECT_LT(glm::length(a.world_from_camera.translation - b.world_from_camera.translation), 1e-3F);
    const glm::vec3 pixel = project(a, {1, 0.5F, 0});
    EXPECT_NEAR(pixel.x, a.cx, 0.01F);
    EXPECT_NEAR(pixel.y, a.cy, 0.01F);
    EXPECT_GT(pixel.z, 0);
  }
  EXPECT_GT(glm::length(path.at(0).world_from_camera.translation - path.at(4).world_from_camera.translation), 5.9F);
}

TEST(CameraPath, StillStays) {
  CameraPath path;
  path.orbit = false;
  EXPECT_EQ(path.at(0).world_from_camera.translation, path.at(5).world_from_camera.translation);
}

}  // namespace
}  // namespace splatbus::viewer
