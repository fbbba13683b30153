// Lights besides the sun: points, spots, cascades, and objects' scale.
#include <gtest/gtest.h>

#include <algorithm>
#include <glm/glm.hpp>
#include <vector>

#include "ball_scene.h"

namespace splatbus::relight {
namespace {

using test::ball_points;
using test::BallOverFloor;
using test::floor_points;
using test::HostMap;
using test::Points;

MappedLight lamp(const glm::vec3& position, const std::vector<HostMap>& faces, float range_m = 20) {
  MappedLight light{.source = {.id = 5, .kind = LightKind::Point, .position = position, .range_m = range_m},
                    .maps = {}};
  for (const HostMap& face : faces) light.maps.push_back(face.view());
  return light;
}

/// Of the point that looks along -y, with a cone to a cosine of 0.8.
constexpr float kCosOuter = 0.8F, kTanOuter = 0.75F;
MappedLight spot(const glm::vec3& position, const HostMap& map) {
  return {.source = {.id = 5,
                     .kind = LightKind::Spot,
                     .position = position,
                     .direction = {0, -1, 0},
                     .range_m = 20,
                     .cos_inner = 0.9F,
                     .cos_outer = kCosOuter},
          .maps = {map.view()}};
}

class Positions : public testing::TestWithParam<glm::vec3> {};

/// Faces meet all over the floor, some of them within the shadow.
TEST_P(Positions, OfALampTheFloorIsDarkBehindTheBallAndLitElsewhereWithoutSeams) {
  const BallOverFloor scene(glm::vec3(0, 1, 0));
  const auto faces = scene.faces(GetParam(), 256);
  const Points points = floor_points();
  const auto seen =
      BallOverFloor::visibility(lamp(GetParam(), faces), BallOverFloor::gaussians(points.position, points.normal));
  int dark = 0;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    const float edge_m = BallOverFloor::distance_to_shadow_edge_m(GetParam(), points.position[i]);
    if (edge_m < -0.06F) {
      ASSERT_EQ(seen[i], 0.0F) << points.position[i].x << ", " << points.position[i].z << ": " << edge_m;
      ++dark;
    } else if (edge_m > 0.06F) {
      ASSERT_EQ(seen[i], 1.0F) << points.position[i].x << ", " << points.position[i].z << ": " << edge_m;
    }
  }
  EXPECT_GT(dark, 300);
}

/// 64 texels a face: 6 cm at the ball, so that slanted surfaces shade themselves where their plane is not theirs.
TEST_P(Positions, OfALampTheBallIsLitTowardsItAndDarkBehind) {
  const BallOverFloor scene(glm::vec3(0, 1, 0));
  const auto faces = scene.faces(GetParam(), 64);
  const Points points = ball_points();
  const auto seen =
      BallOverFloor::visibility(lamp(GetParam(), faces), BallOverFloor::gaussians(points.position, points.normal));
  int lit = 0;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    const float facing = glm::dot(points.normal[i], glm::normalize(GetParam() - points.position[i]));
    if (facing > 0.3F) {
      ASSERT_GT(seen[i], 0.97F) << "cosine " << facing;
      ++lit;
    } else if (facing < 0.0F) {
      ASSERT_EQ(seen[i], 0.0F) << "cosine " << facing;
    }
  }
  EXPECT_GT(lit, 500);
}

INSTANTIATE_TEST_SUITE_P(Lamps, Positions,
                         testing::Values(glm::vec3(0.2F, 2.2F, 0.1F), glm::vec3(1, 1.8F, 0.3F),
                                         glm::vec3(-0.9F, 1.6F, -0.8F)));

TEST(Lamp, ReachesAsFarAsItsRange) {
  const glm::vec3 position(2, 1, 0);
  const BallOverFloor scene(glm::vec3(0, 1, 0));
  const auto faces = scene.faces(position, 64);
  const GaussiansBuffer model =
      BallOverFloor::gaussians({{2, 0, 0}, {2, 0, 1.6F}, {2, 0, 1.8F}}, {{0, 1, 0}, {0, 1, 0}, {0, 1, 0}});
  EXPECT_EQ(BallOverFloor::visibility(lamp(position, faces, 2), model), (std::vector<float>{1, 1, 0}));
}

/// A texel at 4 m is 12.5 cm wide: what stands less before the floor than that is the floor itself.
TEST(Lamp, RaisesAPointByATexelAtItsDistance) {
  const glm::vec3 position(0.1F, 4, 0.1F);
  const BallOverFloor scene(glm::vec3(0, 1, 0));
  const GaussiansBuffer model = BallOverFloor::gaussians({{0, 0, 0}}, {{0, 1, 0}});
  const Rigid down{.rotation = glm::angleAxis(1.5707964F, glm::vec3(1, 0, 0)), .translation = position};
  const auto seen = [&](float blocker_m) {
    HostMap map = scene.pinhole(down, 1.0F, 64);
    std::ranges::fill(map.depth_m, blocker_m);
    return BallOverFloor::visibility(lamp(position, {map}), model)[0];
  };
  EXPECT_EQ(seen(3.9F), 1.0F);
  EXPECT_EQ(seen(3.85F), 0.0F);
}

TEST(Lamp, WithoutShadowIsSeenEverywhereAndNeedsNoMap) {
  const BallOverFloor scene(glm::vec3(0, 1, 0));
  const Points points = floor_points();
  MappedLight light = lamp({0, 2, 0}, {});
  light.source.casts_shadow = false;
  const auto seen = BallOverFloor::visibility(light, BallOverFloor::gaussians(points.position, points.normal));
  EXPECT_EQ(std::ranges::count(seen, 1.0F), static_cast<std::ptrdiff_t>(seen.size()));
}

TEST(Lamp, PenumbraIsAsWideAsTheFilterAtTheFloorsDistance) {
  const glm::vec3 position(0, 2.8F, 0);
  const BallOverFloor scene(glm::vec3(0, 1, 0));
  const auto faces = scene.faces(position, 1024);
  std::vector<glm::vec3> points;
  for (int i = 0; i < 600; ++i) points.emplace_back(0.4F + 0.001F * static_cast<float>(i), 0, 0);
  const auto seen = BallOverFloor::visibility(
      lamp(position, faces), BallOverFloor::gaussians(points, std::vector<glm::vec3>(points.size(), {0, 1, 0})), {},
      {.softness_m = 0.05F, .footprint = 0});
  const auto between = std::ranges::count_if(seen, [](float v) { return v > 0 && v < 1; });
  // As wide as the filter along the map: the face that looks down is turned by some 12 degrees, which the floor's slant
  // in it, and what is farther away, make more of.
  EXPECT_NEAR(0.001F * static_cast<float>(between), 2 * 1.2247F * 0.05F, 0.015F);
}

TEST(Spot, IsDarkOutsideOfItsConeAndBehindTheBall) {
  const glm::vec3 position(0.3F, 3, 0);
  const BallOverFloor scene(glm::vec3(0, 1, 0));
  const Rigid down{.rotation = glm::angleAxis(1.5707964F, glm::vec3(1, 0, 0)), .translation = position};
  const HostMap map = scene.pinhole(down, kTanOuter, 256);
  std::vector<glm::vec3> points;
  for (int x = -70; x <= 70; ++x) {
    for (int z = -70; z <= 70; ++z)
      points.emplace_back(0.05F * static_cast<float>(x), 0, 0.05F * static_cast<float>(z));
  }
  const auto seen = BallOverFloor::visibility(
      spot(position, map), BallOverFloor::gaussians(points, std::vector<glm::vec3>(points.size(), {0, 1, 0})));
  int dark = 0, lit = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const float off_axis_m = glm::length(glm::vec2(points[i].x - position.x, points[i].z - position.z));
    const float edge_m = BallOverFloor::distance_to_shadow_edge_m(position, points[i]);
    if (off_axis_m > kTanOuter * position.y + 0.01F) {
      ASSERT_EQ(seen[i], 0.0F);
    } else if (edge_m < -0.06F) {
      ASSERT_EQ(seen[i], 0.0F);
      ++dark;
    } else if (edge_m > 0.06F && off_axis_m < kTanOuter * position.y - 0.01F) {
      ASSERT_EQ(seen[i], 1.0F) << off_axis_m;
      ++lit;
    }
  }
  EXPECT_GT(dark, 100);
  EXPECT_GT(lit, 1000);
}

/// The finest map that has the whole filter says it, and the last one of what none has.
TEST(Cascades, TheFinestThatHasTheFilterIsTested) {
  const BallOverFloor scene(glm::vec3(0, 1, 0), 64);
  const auto one_of = [](const LightDepthMap& map, float side_m, float depth_m) {
    HostMap other{.camera = map.camera, .depth_m = {}};
    other.camera.fx = other.camera.fy = static_cast<float>(map.camera.width) / side_m;
    other.depth_m.assign(std::size_t{map.camera.width} * map.camera.height, depth_m);
    return other;
  };
  // Everything is in the shade by the first map, in the light by the second, and by the third in the shade.
  const HostMap fine = one_of(scene.map(), 1, 1), middle = one_of(scene.map(), 2, 30),
                coarse = one_of(scene.map(), 4, 1);
  MappedLight sun = scene.sun();
  sun.maps = {fine.view(), middle.view(), coarse.view()};
  // Texels of 1.6 cm and 3.1 cm; the filter takes 1.5 of them and more to either side.
  const std::vector<glm::vec3> points{{0.40F, 0, 0},  {0.495F, 0, 0}, {0.9F, 0, 0},
                                      {0, 0, -0.99F}, {1.9F, 0, 0},   {3, 0, 0}};
  const auto seen = BallOverFloor::visibility(
      sun, BallOverFloor::gaussians(points, std::vector<glm::vec3>(points.size(), {0, 1, 0})));
  EXPECT_EQ(seen, (std::vector<float>{0, 1, 1, 0, 0, 1}));
}

/// p_world = R s p_object + t, and the filter grows with the object.
TEST(ObjectScale, AppliesToPlaceAndFootprint) {
  const BallOverFloor scene(glm::vec3(0.001F, 1, 0));
  const float scale = 2.5F;
  std::vector<glm::vec3> points, in_object;
  ObjectTransform object(Rigid{.rotation = glm::angleAxis(0.7F, glm::vec3(0, 1, 0)), .translation = {0.3F, 0, -0.2F}});
  object.scale = scale;
  for (int i = 0; i < 80; ++i) {
    points.emplace_back(0.42F + 0.002F * static_cast<float>(i), 0, 0.05F);
    in_object.push_back(object_point(object, points.back()));
  }
  const std::vector<glm::vec3> normals(points.size(), glm::vec3(0, 1, 0));
  GaussiansBuffer expected = BallOverFloor::gaussians(points, normals);
  for (std::size_t c = 0; c < 3; ++c) {
    const std::size_t row = (ParameterLayout::kLogScale + c) * expected.stride();
    for (std::size_t i = 0; i < points.size(); ++i) expected.parameters[row + i] += std::log(scale);
  }
  const auto of_object =
      BallOverFloor::visibility(scene.sun(), BallOverFloor::gaussians(in_object, normals, 7), {{7, object}});
  const auto of_world = BallOverFloor::visibility(scene.sun(), expected);
  int partly = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    EXPECT_NEAR(of_object[i], of_world[i], 0.02F);
    partly += of_world[i] > 0.1F && of_world[i] < 0.9F ? 1 : 0;
  }
  EXPECT_GT(partly, 5);
}

}  // namespace
}  // namespace splatbus::relight
