#include "relight/visibility.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
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

TEST(Visibility, IsThatOfThePlaceOnTheSurfaceWhereTheGaussianIsByNow) {
  const BallOverFloor scene(glm::vec3(0.001F, 1, 0));
  const glm::vec3 shaded(0, 0, 0), lit(2, 0, 0);
  const std::vector<glm::vec3> samples{shaded, lit, shaded}, normals(3, glm::vec3(0, 1, 0));
  GaussiansBuffer model = BallOverFloor::gaussians(samples, normals);
  const std::vector<glm::vec3> means{lit + glm::vec3(0, 0.3F, 0), shaded - glm::vec3(0, 0.3F, 0), shaded};
  for (std::size_t i = 0; i < means.size(); ++i) {
    for (int c = 0; c < 3; ++c) model.parameters[static_cast<std::size_t>(c) * model.stride() + i] = means[i][c];
  }
  EXPECT_EQ(BallOverFloor::visibility(scene.sun(), model), (std::vector<float>{1, 0, 0}));
}

TEST(Visibility, PenumbraIsAsWideAsTheGaussian) {
  const BallOverFloor scene(glm::vec3(0.001F, 1, 0));
  std::vector<glm::vec3> points;
  for (int i = 0; i < 400; ++i) points.emplace_back(0.3F + 0.001F * static_cast<float>(i), 0, 0);
  GaussiansBuffer model = BallOverFloor::gaussians(points, std::vector<glm::vec3>(points.size(), glm::vec3(0, 1, 0)));
  // A filter of radius r widens an edge to 2 r: r is sqrt(1.5) times softness plus the share of the two larger
  // deviations' mean, (0.06 + 0.02) / 2.
  const auto penumbra_m = [&](float footprint) {
    for (std::size_t i = 0; i < points.size(); ++i) {
      const std::array<float, 3> deviation_m{0.001F, 0.06F, 0.02F};
      for (std::size_t c = 0; c < 3; ++c) {
        model.parameters[(ParameterLayout::kLogScale + c) * model.stride() + i] = std::log(deviation_m.at(c));
      }
    }
    std::vector<std::uint8_t> visibility(points.size());
    compute_visibility({}, model.view(), {}, {{scene.sun()}}, {.softness_m = 0.03F, .footprint = footprint},
                       visibility.data());
    return 0.001F *
           static_cast<float>(std::ranges::count_if(visibility, [](std::uint8_t v) { return v > 0 && v < 255; }));
  };
  const float texel_m = 6.0F / 512;
  EXPECT_NEAR(penumbra_m(0), 2 * 1.2247F * 0.03F, 2 * texel_m);
  EXPECT_NEAR(penumbra_m(2), 2 * 1.2247F * (0.03F + 2 * 0.04F), 2 * texel_m);
}

/// The same Gaussians page by page, those of a second page in an object's frame.
TEST(Visibility, OfAModelInPagesIsThatOfItsGaussians) {
  const BallOverFloor scene(glm::vec3(0.001F, 1, 0));
  std::vector<glm::vec3> points;
  for (int i = 0; i < 40; ++i) points.emplace_back(0.02F * static_cast<float>(i), 0, 0);
  const std::vector<glm::vec3> normals(points.size(), glm::vec3(0, 1, 0));
  const GaussiansBuffer plain = BallOverFloor::gaussians(points, normals, 7);
  const ObjectTransforms objects{{7, Rigid{.translation = {-0.3F, 0, 0}}}};
  const auto still = scene.visibility(points, normals, objects, 0);
  const auto moved = scene.visibility(points, normals, objects, 7);

  constexpr std::size_t kFields =
      ParameterLayout::kLogScale + 3 + 6;  // log scales at their place, then point and normal
  std::vector<float> pages(2 * kFields * kPageLanes, std::numeric_limits<float>::quiet_NaN());
  for (std::size_t page = 0; page < 2; ++page) {
    for (std::size_t i = 0; i < points.size(); ++i) {
      float* const lane = pages.data() + page * kFields * kPageLanes + i;
      for (std::size_t c = 0; c < 3; ++c) {
        lane[(ParameterLayout::kLogScale + c) * kPageLanes] = std::log(0.01F);
        lane[(kFields - 6 + c) * kPageLanes] = lane[c * kPageLanes] = points[i][static_cast<int>(c)];
        lane[(kFields - 3 + c) * kPageLanes] = normals[i][static_cast<int>(c)];
      }
    }
  }
  const auto count = static_cast<std::uint32_t>(points.size());
  const std::vector<IndexRange> ranges{{.first = 0, .count = count},
                                       {.first = kPageLanes, .count = count, .frame_id = 7}};
  GaussiansView view = plain.view();
  view.object_id = nullptr;
  view.count = kPageLanes + count;
  view.stride = kPageLanes;
  view.page_shift = kPageShift;
  view.page_stride = kFields * kPageLanes;
  view.ranges = ranges;
  view.parameters = pages.data();
  view.surface_point = pages.data() + (kFields - 6) * kPageLanes;
  view.normal = pages.data() + (kFields - 3) * kPageLanes;
  std::vector<std::uint8_t> visibility(view.count);
  compute_visibility({}, view, objects, {{scene.sun()}}, {}, visibility.data());
  for (std::size_t i = 0; i < points.size(); ++i) {
    EXPECT_EQ(static_cast<float>(visibility[i]) / 255, still[i]) << i;
    EXPECT_EQ(static_cast<float>(visibility[kPageLanes + i]) / 255, moved[i]) << i;
  }
  EXPECT_NE(still, moved);
}

TEST(Visibility, AppliesTheObjectsTransform) {
  const BallOverFloor scene(glm::vec3(0.001F, 1, 0));
  // In its own frame the point is under the ball; the transform takes it 2 m aside, and back.
  const std::vector<glm::vec3> points{{0, 0, 0}, {2, 0, 0}};
  const std::vector<glm::vec3> normals(2, glm::vec3(0, 1, 0));
  const ObjectTransforms objects{{7, Rigid{.translation = {2, 0, 0}}}};
  EXPECT_EQ(scene.visibility(points, normals, objects, 7)[0], 1.0F);
  EXPECT_EQ(scene.visibility(points, normals, objects, 8)[0], 0.0F) << "not a moving object";
  const ObjectTransforms back{{7, Rigid{.translation = {-2, 0, 0}}}};
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
