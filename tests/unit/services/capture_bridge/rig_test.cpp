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

TEST(Viewer, HeadingIsTheAngleAboutY) {
  for (const float angle : {-2.0F, 0.0F, 0.4F, 3.0F}) {
    const glm::vec3 forward = glm::angleAxis(angle, glm::vec3(0, 1, 0)) * glm::vec3(0, 0, -1);
    EXPECT_NEAR((ViewerState{.forward = forward}.heading()), angle, 1e-5F);
  }
  EXPECT_EQ((ViewerState{.forward = {0, -1, 0}}.heading(1.25F)), 1.25F);
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

TEST(InputRigTracker, MovesOnlyBeyondItsThresholds) {
  InputRigTracker tracker;
  const InputRigTracker::Options options{.focus_m = 3, .move_m = 0.5F, .turn_radians = 0.5F};
  EXPECT_TRUE(tracker.update(options, nullptr, {}));
  EXPECT_EQ(tracker.pose().centre, options.centre);
  EXPECT_FALSE(tracker.update(options, nullptr, {}));

  ViewerState viewer{.position = {0, 0.25F, 3}, .forward = {0, 0, -1}};
  EXPECT_FALSE(tracker.update(options, &viewer, {})) << "the viewer looks at the default centre";
  viewer.position.x = 0.4F;
  EXPECT_FALSE(tracker.update(options, &viewer, {}));
  viewer.position.x = 0.6F;
  EXPECT_TRUE(tracker.update(options, &viewer, {}));
  EXPECT_NEAR(tracker.pose().centre.x, 0.6F, 1e-5F);
  EXPECT_FALSE(tracker.update(options, &viewer, {}));
  // Turning on the spot moves the focus too; turning about the focus does not.
  viewer.forward = glm::angleAxis(0.6F, glm::vec3(0, 1, 0)) * glm::vec3(0, 0, -1);
  viewer.position = tracker.pose().centre - 3.0F * viewer.forward;
  EXPECT_TRUE(tracker.update(options, &viewer, {}));
  EXPECT_NEAR(tracker.pose().heading_radians, 0.6F, 1e-5F);
}

TEST(InputRigTracker, AHeadingThatWrapsIsNotATurn) {
  InputRigTracker tracker;
  const InputRigTracker::Options options{.fixed_centre = true};
  ViewerState viewer{.forward = glm::angleAxis(3.1F, glm::vec3(0, 1, 0)) * glm::vec3(0, 0, -1)};
  EXPECT_TRUE(tracker.update(options, &viewer, {}));
  viewer.forward = glm::angleAxis(-3.1F, glm::vec3(0, 1, 0)) * glm::vec3(0, 0, -1);
  EXPECT_FALSE(tracker.update(options, &viewer, {}));
}

TEST(InputRigTracker, KeepsTheCentreAmongTheContent) {
  InputRigTracker tracker;
  const InputRigTracker::Options options{.focus_m = 5};
  const ViewerState up{.position = {0, 1, 0}, .forward = {0, 0.8F, -0.6F}};
  EXPECT_TRUE(tracker.update(options, &up, {.low_m = 0, .high_m = 2}));
  EXPECT_FLOAT_EQ(tracker.pose().centre.y, 2);
  const ViewerState down{.position = {0, 1, 0}, .forward = {0, -0.8F, -0.6F}};
  EXPECT_TRUE(tracker.update(options, &down, {.low_m = 0, .high_m = 2}));
  EXPECT_FLOAT_EQ(tracker.pose().centre.y, 0);
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
