#include "relight/visibility.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/glm.hpp>
#include <limits>
#include <vector>

#include "ball_scene.h"

namespace splatbus::relight {
namespace {

using test::ball_points;
using test::BallOverFloor;
using test::floor_points;
using test::Points;

class SunDirections : public testing::TestWithParam<glm::vec3> {};

TEST_P(SunDirections, FloorIsDarkUnderTheBallAndLitOutsideWithoutAcne) {
  const BallOverFloor scene(GetParam());
  const Points points = floor_points();
  const auto visibility = scene.visibility(points.position, points.normal);
  int dark = 0;
  for (std::size_t i = 0; i < visibility.size(); ++i) {
    const float edge_m = scene.distance_to_shadow_edge_m(points.position[i]);
    if (edge_m < -0.06F) {
      EXPECT_EQ(visibility[i], 0.0F) << "inside the shadow by " << -edge_m << " m";
      ++dark;
    } else if (edge_m > 0.06F) {
      EXPECT_EQ(visibility[i], 1.0F) << "outside the shadow by " << edge_m << " m";
    } else {
      EXPECT_GE(visibility[i], 0.0F);
      EXPECT_LE(visibility[i], 1.0F);
    }
  }
  EXPECT_GT(dark, 500);
}

TEST_P(SunDirections, BallIsLitTowardsTheSunAndDarkBehind) {
  const BallOverFloor scene(GetParam());
  const Points points = ball_points();
  const auto visibility = scene.visibility(points.position, points.normal);
  for (std::size_t i = 0; i < visibility.size(); ++i) {
    const float facing = glm::dot(points.normal[i], scene.to_sun());
    if (facing > 0.2F) {
      EXPECT_GT(visibility[i], 0.99F) << "cosine " << facing;
    } else if (facing < 0.0F) {
      EXPECT_EQ(visibility[i], 0.0F) << "cosine " << facing;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Slants, SunDirections,
                         testing::Values(glm::vec3(0.001F, 1, 0), glm::vec3(0.5F, 1, 0.3F), glm::vec3(1, 1, -0.4F),
                                         glm::vec3(-1.0F, 0.6F, 0.2F)));

TEST(Visibility, PenumbraRisesMonotonouslyAcrossTheEdge) {
  const BallOverFloor scene(glm::vec3(0.001F, 1, 0));
  std::vector<glm::vec3> points;
  for (int i = 0; i < 40; ++i) points.emplace_back(0.45F + 0.0025F * static_cast<float>(i), 0, 0);
  const std::vector<glm::vec3> normals(points.size(), glm::vec3(0, 1, 0));
  const auto visibility = scene.visibility(points, normals, {}, 0, {.softness_m = 0.03F});
  EXPECT_EQ(visibility.front(), 0.0F);
  EXPECT_EQ(visibility.back(), 1.0F);
  int between = 0;
  for (std::size_t i = 1; i < visibility.size(); ++i) {
    EXPECT_GE(visibility[i], visibility[i - 1] - 0.02F);
    between += visibility[i] > 0.05F && visibility[i] < 0.95F ? 1 : 0;
  }
  EXPECT_GT(between, 5);
}

TEST(Visibility, AppliesTheObjectsTransform) {
  const BallOverFloor scene(glm::vec3(0.001F, 1, 0));
  // In its own frame the point is under the ball; the transform takes it 2 m aside, and back.
  const std::vector<glm::vec3> points{{0, 0, 0}, {2, 0, 0}};
  const std::vector<glm::vec3> normals(2, glm::vec3(0, 1, 0));
  const ObjectTransforms objects{{7, {.translation = {2, 0, 0}}}};
  EXPECT_EQ(scene.visibility(points, normals, objects, 7)[0], 1.0F);
  EXPECT_EQ(scene.visibility(points, normals, objects, 8)[0], 0.0F) << "not a moving object";
  const ObjectTransforms back{{7, {.translation = {-2, 0, 0}}}};
  EXPECT_EQ(scene.visibility(points, normals, back, 7)[1], 0.0F);
}

TEST(Visibility, OutsideOfTheMapIsLitAndNonsenseIsDark) {
  const BallOverFloor scene(glm::vec3(0.5F, 1, 0.3F));
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const auto visibility = scene.visibility({{50, 0, 0}, {nan, 0, 0}, {0, 0, 0}, {1e30F, 1e30F, 0}},
                                           {{0, 1, 0}, {0, 1, 0}, {nan, nan, nan}, {0, 1, 0}});
  EXPECT_EQ(visibility[0], 1.0F);
  EXPECT_EQ(visibility[1], 0.0F);
  EXPECT_EQ(visibility[2], 0.0F);
  EXPECT_TRUE(std::isfinite(visibility[3]));
}

}  // namespace
}  // namespace splatbus::relight
