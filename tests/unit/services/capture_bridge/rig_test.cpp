#include "capture-bridge/rig.h"

#include <gtest/gtest.h>

#include <glm/gtc/constants.hpp>

namespace splatbus::capture_bridge {
namespace {

glm::vec3 forward_of(const Camera& camera) {
  return camera.world_from_camera.rotation * glm::vec3(0, 0, 1);
}
glm::vec3 down_of(const Camera& camera) {
  return camera.world_from_camera.rotation * glm::vec3(0, 1, 0);
}

TEST(Dome, LooksAtItsCentreFromAboveAtItsRadius) {
  const glm::vec3 centre(1, 0.5F, -2);
  const auto cameras = dome_cameras({.cameras = 24, .size = 128, .radius_m = 3}, centre, 0.3F);
  ASSERT_EQ(cameras.size(), 24U);
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    EXPECT_EQ(cameras[i].id, i);
    EXPECT_EQ(cameras[i].role, CameraRole::Input);
    const glm::vec3 offset = cameras[i].world_from_camera.translation - centre;
    EXPECT_NEAR(glm::length(offset), 3, 1e-4F);
    EXPECT_GT(offset.y, 0.1F);
    EXPECT_NEAR(glm::dot(forward_of(cameras[i]), -glm::normalize(offset)), 1, 1e-5F);
    EXPECT_LT(down_of(cameras[i]).y, 0);
    const glm::vec3 pixel = project(cameras[i], centre);
    EXPECT_NEAR(pixel.x, 64, 1e-2F);
    EXPECT_NEAR(pixel.y, 64, 1e-2F);
  }
}

TEST(Dome, SpreadsEvenly) {
  const auto cameras = dome_cameras({.cameras = 24, .radius_m = 1}, glm::vec3(0), 0);
  // 24 even directions on a half sphere are about 0.5 rad from their nearest neighbour.
  for (const Camera& a : cameras) {
    float nearest = 10;
    for (const Camera& b : cameras) {
      if (a.id != b.id)
        nearest = std::min(nearest, glm::distance(a.world_from_camera.translation, b.world_from_camera.translation));
    }
    EXPECT_GT(nearest, 0.3F);
    EXPECT_LT(nearest, 0.7F);
  }
}

TEST(Dome, TurnsWithTheHeading) {
  const DomeOptions options{.cameras = 8, .radius_m = 2};
  const glm::vec3 centre(0.5F, 0, 1);
  const auto before = dome_cameras(options, centre, 0);
  const auto after = dome_cameras(options, centre, 0.7F);
  // What stood in a direction relative to the viewer's heading stands there still.
  const glm::quat turn = glm::angleAxis(0.7F, glm::vec3(0, 1, 0));
  for (std::size_t i = 0; i < before.size(); ++i) {
    const glm::vec3 expected = centre + turn * (before[i].world_from_camera.translation - centre);
    EXPECT_LT(glm::distance(after[i].world_from_camera.translation, expected), 1e-4F);
  }
}

TEST(Ring, StandsAboutTheTarget) {
  const RingOptions options{
      .cameras = 10, .size = 256, .radius_m = 3, .height_m = 1.5F, .phase_radians = 0.1F, .target = {1, 0.25F, 2}};
  const auto cameras = ring_cameras(options);
  ASSERT_EQ(cameras.size(), 10U);
  for (const Camera& camera : cameras) {
    const glm::vec3 eye = camera.world_from_camera.translation;
    EXPECT_NEAR(glm::length(glm::vec2(eye.x - 1, eye.z - 2)), 3, 1e-4F);
    EXPECT_FLOAT_EQ(eye.y, 1.5F);
    EXPECT_NEAR(project(camera, options.target).x, 128, 1e-2F);
    EXPECT_NEAR(project(camera, options.target).y, 128, 1e-2F);
    EXPECT_EQ(camera.role, CameraRole::Reference);
  }
  EXPECT_NEAR(cameras[0].world_from_camera.translation.x, 1 + 3 * std::cos(0.1F), 1e-4F);
  EXPECT_NEAR(cameras[0].world_from_camera.translation.z, 2 + 3 * std::sin(0.1F), 1e-4F);
}

TEST(Follow, OneAlignedTwoAtTheSidesOneAboveAllConverging) {
  const Camera viewer = look_at({2, 1.6F, 2}, {0, 0.5F, 0}, 640, 480, 1);
  const auto cameras = follow_cameras({.cameras = 7, .side_m = 0.5F, .above_m = 0.4F, .toe_in_radians = 0.1F}, viewer);
  ASSERT_EQ(cameras.size(), 7U);
  const Rigid viewer_from_world = inverse(viewer.world_from_camera);
  const auto local = [&](std::size_t i) { return viewer_from_world * cameras[i].world_from_camera.translation; };
  const auto axis = [&](std::size_t i) { return viewer_from_world.rotation * forward_of(cameras[i]); };
  EXPECT_LT(glm::length(local(0)), 1e-5F);
  EXPECT_GT(axis(0).z, 0.99999F);
  EXPECT_LT(glm::distance(local(1), glm::vec3(-0.5F, 0, 0)), 1e-5F);
  EXPECT_GT(axis(1).x, 0.09F);
  EXPECT_LT(glm::distance(local(2), glm::vec3(0.5F, 0, 0)), 1e-5F);
  EXPECT_LT(axis(2).x, -0.09F);
  EXPECT_LT(glm::distance(local(3), glm::vec3(0, -0.4F, 0)), 1e-5F);
  EXPECT_GT(axis(3).y, 0.09F);
  EXPECT_LT(glm::distance(local(4), glm::vec3(-1, 0, 0)), 1e-5F);
  for (std::size_t i = 0; i < cameras.size(); ++i) EXPECT_EQ(cameras[i].id, i);
}

TEST(Dome, AndRingHaveWidePictures) {
  const auto dome = dome_cameras({.cameras = 3, .size = {96, 40}, .fov_radians = 0.8F}, glm::vec3(0), 0);
  const auto ring = ring_cameras({.cameras = 3, .size = {96, 40}, .fov_radians = 0.8F});
  for (const auto& cameras : {dome, ring}) {
    for (const Camera& camera : cameras) {
      EXPECT_EQ(camera.width, 96U);
      EXPECT_EQ(camera.height, 40U);
      EXPECT_NEAR(std::atan(20 / camera.fy), 0.4F, 1e-5F) << "the field of view is vertical";
      EXPECT_EQ(camera.fx, camera.fy);
    }
  }
}

/// What stands at the edges of the viewer's picture is in the aligned camera's, with a margin.
TEST(Follow, TakesTheViewersPictureAndAMargin) {
  for (const auto& [width, height, fov] : {std::tuple(640, 360, 1.2F), std::tuple(300, 500, 0.5F)}) {
    const Camera viewer =
        look_at({2, 1.6F, 2}, {0, 0.5F, 0}, static_cast<std::uint32_t>(width), static_cast<std::uint32_t>(height), fov);
    const FollowOptions options{.cameras = 4, .size = {128, 128}, .viewers_picture = true, .margin = 1.2F};
    for (const Camera& camera : follow_cameras(options, viewer)) {
      const auto pixels = static_cast<float>(camera.width * camera.height);
      EXPECT_NEAR(pixels, 128 * 128, 0.02F * 128 * 128);
      EXPECT_FLOAT_EQ(camera.fx, camera.fy);
      const auto edge = [](std::uint32_t side, float focal) { return static_cast<float>(side) / 2 / focal; };
      EXPECT_NEAR(edge(camera.width, camera.fx), 1.2F * edge(viewer.width, viewer.fx), 0.02F);
      EXPECT_NEAR(edge(camera.height, camera.fy), 1.2F * edge(viewer.height, viewer.fy), 0.02F);
    }
    const Camera aligned = follow_cameras(options, viewer).front();
    const glm::vec3 corner = project(aligned, unproject(viewer, 0, 0, 3));
    EXPECT_GT(corner.x, 0);
    EXPECT_GT(corner.y, 0);
  }
  const Camera fisheye = look_at({0, 0, 0}, {0, 0, 1}, 64, 64, 3.1F);
  const Camera bounded = follow_cameras({.cameras = 1, .viewers_picture = true}, fisheye).front();
  EXPECT_NEAR(2 * std::atan(80 / bounded.fy), glm::radians(150.0F), 1e-3F);
}

TEST(ParseSize, TakesASideOrTwo) {
  PictureSize size = 7;
  EXPECT_TRUE(parse_size("160", 8, 4096, size));
  EXPECT_EQ(size, PictureSize(160, 160));
  EXPECT_TRUE(parse_size("256x144", 8, 4096, size));
  EXPECT_EQ(size, PictureSize(256, 144));
  for (const char* bad :
       {"", "x", "256x", "x144", "256x144x2", "256 144", "7", "256x7", "4097x8", "-160", "1e9", "a"}) {
    EXPECT_FALSE(parse_size(bad, 8, 4096, size)) << bad;
    EXPECT_EQ(size, PictureSize(256, 144)) << bad;
  }
}

TEST(ParsePoint, TakesThreeNumbersOnly) {
  glm::vec3 point(7);
  EXPECT_TRUE(parse_point("0, 0.25,-3", point));
  EXPECT_EQ(point, glm::vec3(0, 0.25F, -3));
  for (const char* bad : {"", "1,2", "1,2,3,4", "1;2;3", "a,b,c", "1,2,3 x"}) {
    EXPECT_FALSE(parse_point(bad, point)) << bad;
    EXPECT_EQ(point, glm::vec3(0, 0.25F, -3)) << bad;
  }
}

}  // namespace
}  // namespace splatbus::capture_bridge
