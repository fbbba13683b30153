#include "viewer/rig.h"

#include <gtest/gtest.h>

#include <cmath>

namespace splatbus::viewer {
namespace {

TEST(Rig, BeginsWhereACameraStands) {
  const Camera camera = look_at({1, 2, 3}, {0.5F, 0.2F, 0}, 640, 480, 1);
  const Rig rig(RigPose::of(camera));
  const Camera seen = rig.camera(640, 480, 1);
  EXPECT_NEAR(glm::distance(seen.world_from_camera.translation, camera.world_from_camera.translation), 0, 1e-4);
  EXPECT_GT(std::abs(glm::dot(seen.world_from_camera.rotation, camera.world_from_camera.rotation)), 1 - 1e-5F);
}

TEST(Rig, OrbitsAboutTheTargetAndLooksAboutTheEye) {
  Rig rig{RigPose{}};
  const RigPose before = rig.goal();
  rig.orbit(0.5F, 0.1F);
  EXPECT_EQ(rig.goal().target_m, before.target_m);
  EXPECT_GT(glm::distance(rig.goal().eye(), before.eye()), 1);
  const glm::vec3 eye = rig.goal().eye();
  rig.look(0.5F, 3);  // beyond the steepest
  EXPECT_NEAR(glm::distance(rig.goal().eye(), eye), 0, 1e-4);
  EXPECT_NEAR(rig.goal().pitch, 1.5F, 1e-6);
}

TEST(Rig, PansByAsManyPixels) {
  Rig rig{RigPose{}};
  const Camera before = rig.camera(800, 600, 1);
  const glm::vec3 point = rig.goal().target_m;
  rig.pan(30, -20, before.fy);
  rig.jump(rig.goal());
  const glm::vec3 at = project(rig.camera(800, 600, 1), point);
  EXPECT_NEAR(at.x, 400 + 30, 0.01);
  EXPECT_NEAR(at.y, 300 - 20, 0.01);
}

TEST(Rig, FliesToWhereItLooksAndFasterWithShift) {
  Rig rig{RigPose{}};
  const glm::vec3 before = rig.goal().target_m;
  const Camera camera = rig.camera(640, 480, 1);
  rig.fly({.ahead = 1}, 0.5F);
  const glm::vec3 step = rig.goal().target_m - before;
  const glm::vec3 looks = camera.world_from_camera.rotation * glm::vec3(0, 0, 1);
  EXPECT_NEAR(glm::distance(step / glm::length(step), looks), 0, 1e-5);
  rig.fly({.ahead = 1, .fast = true}, 0.5F);
  EXPECT_NEAR(glm::length(rig.goal().target_m - before), 5 * glm::length(step), 1e-3);
}

TEST(Rig, RisesAsTheWorldHasIt) {
  Rig rig{RigPose{}};
  const glm::vec3 before = rig.goal().target_m;
  rig.fly({.up = 1}, 0.5F);
  const glm::vec3 step = rig.goal().target_m - before;
  EXPECT_EQ(step.x, 0);
  EXPECT_EQ(step.z, 0);
  EXPECT_GT(step.y, 0);
}

TEST(Rig, LeavesWhatIsNearAtAMetreASecond) {
  RigPose near;
  near.distance_m = 0.05F;
  Rig rig{near};
  rig.fly({.right = 1}, 0.5F);
  EXPECT_NEAR(glm::distance(rig.goal().target_m, near.target_m), 0.5F, 1e-5);
}

TEST(Rig, FramesASphere) {
  Rig rig{RigPose{}};
  rig.frame({3, 0, 1}, 2, 1);
  rig.jump(rig.goal());
  const glm::vec3 centre = project(rig.camera(500, 500, 1), {3, 0, 1});
  EXPECT_NEAR(centre.x, 250, 0.1);
  EXPECT_NEAR(centre.z, 0.75F * 2 / std::sin(0.5F), 1e-3);
}

TEST(Rig, ComesToItsGoalSmoothlyAtAnyFrameRate) {
  Rig often{RigPose{}}, seldom{RigPose{}};
  for (Rig* rig : {&often, &seldom}) rig->orbit(1, 0);
  for (int k = 0; k < 12; ++k) EXPECT_TRUE(often.advance(0.005F));
  EXPECT_TRUE(seldom.advance(0.06F));
  EXPECT_NEAR(seldom.shown().yaw, 1 - std::exp(-1.0F), 1e-5);
  EXPECT_NEAR(often.shown().yaw, seldom.shown().yaw, 1e-4);
  for (int k = 0; k < 100; ++k) often.advance(0.01F);
  EXPECT_EQ(often.shown(), often.goal());
  EXPECT_FALSE(often.advance(0.01F));
}

}  // namespace
}  // namespace splatbus::viewer
