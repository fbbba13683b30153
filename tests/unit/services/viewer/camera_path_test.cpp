#include "viewer/camera_path.h"

#include <gtest/gtest.h>

#include <fstream>
#include <glm/gtc/constants.hpp>

#include "../../bus/bus_fixture.h"
#include "../../nanoseconds.h"
#include "bus/error.h"

namespace splatbus::viewer {
namespace {

glm::vec3 eye(const Camera& camera) {
  return camera.world_from_camera.translation;
}

glm::vec3 forward(const Camera& camera) {
  return camera.world_from_camera.rotation * glm::vec3(0, 0, 1);
}

class CameraPathFileTest : public testing::Test {
 protected:
  PathOptions along(PathKind kind, const std::string& text) {
    const std::string file = directory_.path() + "/way.txt";
    std::ofstream(file) << text;
    return {.kind = kind, .file = file};
  }
  bus_test::TemporaryDirectory directory_;
};

TEST(CameraPath, OrbitReturnsAfterOnePeriodAndLooksAtTheTarget) {
  const CameraPath path({.radius_m = 3, .period_s = 8, .target_m = {1, 0.5F, 0}});
  for (const double t : {0.0, 1.0, 3.5}) {
    const Camera a = path.at(t), b = path.at(t + 8);
    EXPECT_LT(glm::length(eye(a) - eye(b)), 1e-3F);
    const glm::vec3 pixel = project(a, {1, 0.5F, 0});
    EXPECT_NEAR(pixel.x, a.cx, 0.01F);
    EXPECT_NEAR(pixel.y, a.cy, 0.01F);
    EXPECT_GT(pixel.z, 0);
  }
  EXPECT_GT(glm::length(eye(path.at(0)) - eye(path.at(4))), 5.9F);
}

TEST(CameraPath, StillStays) {
  const CameraPath path({.kind = PathKind::Still});
  EXPECT_EQ(eye(path.at(0)), eye(path.at(5)));
}

TEST_F(CameraPathFileTest, WalkLooksAlongTheWay) {
  PathOptions options = along(PathKind::Walk, "0 1.6 0\n0 1.6 -14\n");
  options.width = 320;
  options.height = 96;
  const Camera camera = CameraPath(options).at(5);
  EXPECT_NEAR(glm::distance(eye(camera), {0, 1.6F, -7}), 0, 1e-4F);
  const glm::vec3 pixel = project(camera, {0, 1.6F, -9});
  EXPECT_NEAR(pixel.x, 160, 0.01F);
  EXPECT_NEAR(pixel.y, 48, 0.01F);
  EXPECT_NEAR(pixel.z, 2, 1e-3F);
}

TEST_F(CameraPathFileTest, FlyKeepsItsSpeedOnTheCurve) {
  const CameraPath path(along(PathKind::Fly, "0 5 0\n20 8 0\n20 2 20\n-10 5 20\n"));
  for (double t = 0; t < 30; t += 0.1) {
    EXPECT_NEAR(glm::distance(eye(path.at(t)), eye(path.at(t + 0.1))), 0.14, 0.002) << t;
  }
}

TEST_F(CameraPathFileTest, RecordedPosesAreJoinedAndTeleportsAreNot) {
  PathOptions options = along(PathKind::Recorded,
                              "10 0 0 0 1 0 0 0\n"
                              "12 4 0 0 0.7071068 0 0.7071068 0\n"  // a quarter about y: z forward becomes x
                              "teleport\n"
                              "14 100 0 0 1 0 0 0\n"
                              "16 102 0 0 1 0 0 0\n");
  const CameraPath path(options);
  EXPECT_NEAR(glm::distance(eye(path.at(1)), {2, 0, 0}), 0, 1e-5F);
  EXPECT_NEAR(glm::distance(forward(path.at(1)), glm::normalize(glm::vec3(1, 0, 1))), 0, 1e-5F);
  EXPECT_NEAR(glm::distance(eye(path.at(3.9)), {4, 0, 0}), 0, 1e-5F) << "until the jump it stays";
  EXPECT_NEAR(glm::distance(eye(path.at(5)), {101, 0, 0}), 0, 1e-5F);
  EXPECT_NEAR(glm::distance(eye(path.at(60)), {102, 0, 0}), 0, 1e-5F);
  options.loop = true;
  EXPECT_NEAR(glm::distance(eye(CameraPath(options).at(7)), {2, 0, 0}), 0, 1e-5F);
}

TEST_F(CameraPathFileTest, NeedsAFileThatCanBeRead) {
  EXPECT_THROW(CameraPath({.kind = PathKind::Walk}), bus::Error);
  EXPECT_THROW(CameraPath(along(PathKind::Fly, "0 0\n")), bus::Error);
}

TEST(PathClock, StopsGoesOnAndBeginsAnew) {
  PathOptions options{.start_s = 7, .run = false};
  PathClock clock(options, 100 * kSecond);
  EXPECT_EQ(clock.seconds(105 * kSecond), 7);
  options.run = true;
  clock.change(options, 110 * kSecond);
  EXPECT_DOUBLE_EQ(clock.seconds(112 * kSecond), 9);
  options.speed_m_s = 3;
  clock.change(options, 113 * kSecond);
  EXPECT_DOUBLE_EQ(clock.seconds(113 * kSecond), 10) << "another parameter changes no time";
  options.run = false;
  clock.change(options, 114 * kSecond);
  EXPECT_DOUBLE_EQ(clock.seconds(120 * kSecond), 11);
  options.start_s = 2;
  clock.change(options, 121 * kSecond);
  EXPECT_DOUBLE_EQ(clock.seconds(122 * kSecond), 2);
}

}  // namespace
}  // namespace splatbus::viewer
