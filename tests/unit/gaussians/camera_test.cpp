#include "gaussians/camera.h"

#include <gtest/gtest.h>

#include "random.h"

namespace splatbus {
namespace {

void expect_near(const glm::vec3& a, const glm::vec3& b, float tolerance) {
  EXPECT_LE(glm::distance(a, b), tolerance)
      << "(" << a.x << " " << a.y << " " << a.z << ") (" << b.x << " " << b.y << " " << b.z << ")";
}

TEST(Rigid, InverseAndProductAreThoseOfMappings) {
  test::Random random(1);
  for (int i = 0; i < 200; ++i) {
    const Rigid a = random.rigid(), b = random.rigid();
    const glm::vec3 p = random.vector(-3, 3);
    expect_near(inverse(a) * (a * p), p, 1e-5F);
    expect_near((a * b) * p, a * (b * p), 1e-5F);
    expect_near((a * inverse(a)) * p, p, 1e-5F);
    EXPECT_NEAR(glm::length((a * b).rotation), 1, 1e-6F);
  }
}

TEST(Camera, LooksAtItsTargetWithYDownAndZForward) {
  const Camera camera = look_at({1, 2, 5}, {1, 2, 0}, 64, 48, glm::radians(60.0F));
  expect_near(project(camera, {1, 2, 0}), {32, 24, 5}, 1e-5F);
  EXPECT_GT(project(camera, {2, 2, 0}).x, 32) << "world x is right when looking along -z";
  EXPECT_LT(project(camera, {1, 3, 0}).y, 24) << "up in the world is up in the picture";
  // The upper edge of the picture is 30 degrees above the axis.
  expect_near(project(camera, {1, 2 + 5 * std::tan(glm::radians(30.0F)), 0}), {32, 0, 5}, 1e-4F);
  EXPECT_EQ(camera.fx, camera.fy);
}

TEST(Camera, LooksStraightUpAndDown) {
  for (const float y : {-1.0F, 1.0F}) {
    const Camera camera = look_at({0, 0, 0}, {0, 3 * y, 0}, 10, 10, 1.0F);
    expect_near(project(camera, {0, 3 * y, 0}), {5, 5, 3}, 1e-5F);
    EXPECT_LT(project(camera, {0, 3 * y, -1}).y, 5) << "the top of the picture is towards -z";
    EXPECT_NEAR(glm::length(camera.world_from_camera.rotation), 1, 1e-6F);
  }
}

TEST(Camera, UnprojectInvertsProject) {
  test::Random random(2);
  for (int i = 0; i < 500; ++i) {
    Camera camera = look_at(random.vector(-4, 4), random.vector(-1, 1), 160, 120, random.uniform(0.3F, 2.0F));
    camera.fy *= 1.3F;
    camera.cx += 7;
    camera.role = i % 2 == 0 ? CameraRole::Reference : CameraRole::Light;
    const glm::vec3 local(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(0.5F, 6));
    const glm::vec3 world = camera.world_from_camera * local;
    const glm::vec3 pixel = project(camera, world);
    EXPECT_NEAR(pixel.z, local.z, 1e-5F);
    expect_near(unproject(camera, pixel.x, pixel.y, pixel.z), world, 2e-5F);
  }
}

TEST(Camera, LightCamerasAreOrthographic) {
  Camera camera = look_at({0, 10, 0}, {0, 0, 0}, 100, 100, 1.0F);
  camera.role = CameraRole::Light;
  camera.fx = camera.fy = 20;  // pixels a metre
  const glm::vec3 near = project(camera, {1, 8, 0}), far = project(camera, {1, -8, 0});
  EXPECT_NEAR(near.x, far.x, 1e-4F);
  EXPECT_NEAR(std::abs(near.x - 50), 20, 1e-4F);
}

}  // namespace
}  // namespace splatbus
