#include "relight/visibility.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/glm.hpp>
#include <limits>
#include <vector>

namespace splatbus::relight {
namespace {

constexpr float kBallRadius_m = 0.5F;
const glm::vec3 kBallCentre{0, 0.8F, 0};

/// A ball over the floor y = 0, seen by the sun in an orthographic map of 6 m.
class BallOverFloor {
 public:
  explicit BallOverFloor(const glm::vec3& to_sun, std::uint32_t texels = 512) : to_sun_(glm::normalize(to_sun)) {
    constexpr float kSide_m = 6.0F;
    camera_ = look_at(10.0F * to_sun_, glm::vec3(0), texels, texels, 1.0F);
    camera_.role = CameraRole::Light;
    camera_.fx = camera_.fy = static_cast<float>(texels) / kSide_m;
    camera_.cx = camera_.cy = static_cast<float>(texels) / 2.0F;
    camera_.far_m = 40.0F;
    depth_m_.resize(std::size_t{texels} * texels);
    for (std::uint32_t y = 0; y < texels; ++y) {
      for (std::uint32_t x = 0; x < texels; ++x) {
        const glm::vec3 origin = unproject(camera_, static_cast<float>(x) + 0.5F, static_cast<float>(y) + 0.5F, 0.0F);
        depth_m_[std::size_t{y} * texels + x] = first_hit_m(origin, -to_sun_);
      }
    }
  }

  [[nodiscard]] float first_hit_m(const glm::vec3& origin, const glm::vec3& direction) const {
    const glm::vec3 offset = origin - kBallCentre;
    const float b = glm::dot(offset, direction);
    const float discriminant = b * b - glm::dot(offset, offset) + kBallRadius_m * kBallRadius_m;
    if (discriminant > 0 && -b - std::sqrt(discriminant) > 0) return -b - std::sqrt(discriminant);
    return direction.y < 0 ? -origin.y / direction.y : camera_.far_m;
  }

  /// Distance of a floor point to the edge of the ball's shadow, metres; negative inside.
  [[nodiscard]] float distance_to_shadow_edge_m(const glm::vec3& point) const {
    const glm::vec3 offset = kBallCentre - point;
    return glm::length(offset - glm::dot(offset, to_sun_) * to_sun_) - kBallRadius_m;
  }

  [[nodiscard]] std::vector<float> visibility(const std::vector<glm::vec3>& points,
                                              const std::vector<glm::vec3>& normals,
                                              const ObjectTransforms& objects = {}, std::uint32_t object = 0,
                                              const VisibilityOptions& options = {}) const {
    GaussiansBuffer gaussians(ParameterLayout{}, points.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
      for (int c = 0; c < 3; ++c) {
        const std::size_t at = static_cast<std::size_t>(c) * gaussians.stride() + i;
        gaussians.surface_point[at] = points[i][c];
        gaussians.normal[at] = normals[i][c];
        gaussians.parameters[(ParameterLayout::kLogScale + static_cast<std::size_t>(c)) * gaussians.stride() + i] =
            std::log(0.01F);
      }
      gaussians.object_id[i] = object;
    }
    std::vector<float> out(points.size(), -1.0F);
    compute_visibility(gaussians.view(), objects, {.camera = camera_, .depth_m = depth_m_.data()}, options, out);
    return out;
  }

  [[nodiscard]] const glm::vec3& to_sun() const { return to_sun_; }

 private:
  glm::vec3 to_sun_;
  Camera camera_;
  std::vector<float> depth_m_;
};

struct Points {
  std::vector<glm::vec3> position, normal;
};

Points floor_points() {
  Points points;
  for (int x = -60; x <= 60; ++x) {
    for (int z = -60; z <= 60; ++z) {
      points.position.emplace_back(0.0203F * static_cast<float>(x), 0.0F, 0.0203F * static_cast<float>(z));
      points.normal.emplace_back(0, 1, 0);
    }
  }
  return points;
}

Points ball_points() {
  Points points;
  constexpr int kCount = 6000;
  for (int i = 0; i < kCount; ++i) {
    const float y = 1.0F - 2.0F * (static_cast<float>(i) + 0.5F) / kCount;
    const float ring = std::sqrt(1.0F - y * y);
    const float angle = 2.39996323F * static_cast<float>(i);
    const glm::vec3 normal(ring * std::cos(angle), y, ring * std::sin(angle));
    points.position.push_back(kBallCentre + kBallRadius_m * normal);
    points.normal.push_back(normal);
  }
  return points;
}

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
