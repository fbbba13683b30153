#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "stream/quantized_scene.h"

namespace splatbus::stream::test {

/// The angle by which unit quaternions differ, in double precision.
inline double angle_between(const glm::quat& a, const glm::quat& b) {
  const auto wide = [](const glm::quat& q) { return glm::normalize(glm::dquat(q.w, q.x, q.y, q.z)); };
  const glm::dquat difference = glm::conjugate(wide(a)) * wide(b);
  return 2 * std::atan2(glm::length(glm::dvec3(difference.x, difference.y, difference.z)), std::abs(difference.w));
}

inline void expect_direction_near(const glm::vec3& got, const glm::vec3& want, float error_rad) {
  EXPECT_LE(glm::length(glm::cross(glm::dvec3(got), glm::dvec3(want))), error_rad);
  EXPECT_GT(glm::dot(got, want), 0);
}

/// What the light's kind has.
inline void expect_source_near(const LightSource& got, const LightSource& want) {
  EXPECT_EQ(got.id, want.id);
  EXPECT_EQ(got.kind, want.kind);
  EXPECT_EQ(got.casts_shadow, want.casts_shadow);
  const float brightest = std::max({want.intensity.x, want.intensity.y, want.intensity.z});
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(got.intensity[c], want.intensity[c], brightest * kMaxLightError);
  if (want.kind != LightKind::Point) expect_direction_near(got.direction, want.direction, kMaxDirectionError_rad);
  if (want.kind == LightKind::Directional) return;
  for (int axis = 0; axis < 3; ++axis) {
    EXPECT_NEAR(got.position[axis], want.position[axis], kMaxPositionError_m + 1e-7F * std::abs(want.position[axis]));
  }
  EXPECT_NEAR(got.range_m, want.range_m, kMaxRangeError * want.range_m);
  if (want.kind == LightKind::Point) return;
  EXPECT_NEAR(got.cos_inner, want.cos_inner, kCosineStep);
  EXPECT_NEAR(got.cos_outer, want.cos_outer, kCosineStep);
  EXPECT_LT(got.cos_outer, got.cos_inner);
}

/// The same objects and light, within what stream/quantized_scene.h states.
inline void expect_scene_near(const SceneState& got, const SceneState& want) {
  EXPECT_EQ(got.version, want.version);
  EXPECT_EQ(got.light.generation, want.light.generation);
  ASSERT_EQ(got.objects.size(), want.objects.size());
  for (const auto& [id, transform] : want.objects) {
    ASSERT_TRUE(got.objects.contains(id)) << id;
    const Rigid& object = got.objects.at(id).rigid;
    for (int axis = 0; axis < 3; ++axis) {
      const float position = transform.rigid.translation[axis];
      EXPECT_NEAR(object.translation[axis], position, kMaxPositionError_m + 1e-7F * std::abs(position));
    }
    const ObjectTransform& whole = got.objects.at(id);
    EXPECT_NEAR(whole.scale, transform.scale, kMaxScaleError * transform.scale);
    EXPECT_EQ(whole.emissive, transform.emissive);
    EXPECT_EQ(whole.modelled, transform.modelled);
    EXPECT_LE(angle_between(object.rotation, transform.rigid.rotation), kMaxRotationError_rad);
  }
  expect_direction_near(got.light.sun_direction, want.light.sun_direction, kMaxSunError_rad);
  ASSERT_EQ(got.light.sources.size(), want.light.sources.size());
  for (std::size_t i = 0; i < want.light.sources.size(); ++i) {
    expect_source_near(got.light.sources[i], want.light.sources[i]);
  }
  const auto expect_color = [](const glm::vec3& color, const glm::vec3& true_color, float largest) {
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(color[c], true_color[c], largest * kMaxLightError);
  };
  const auto largest = [](const glm::vec3& v) { return std::max({std::abs(v.x), std::abs(v.y), std::abs(v.z)}); };
  expect_color(got.light.sun_irradiance, want.light.sun_irradiance, largest(want.light.sun_irradiance));
  expect_color(got.light.background, want.light.background, largest(want.light.background));
  float most = 0;
  for (const glm::vec3& c : want.light.ambient_sh) most = std::max(most, largest(c));
  for (std::size_t k = 0; k < 9; ++k) expect_color(got.light.ambient_sh[k], want.light.ambient_sh[k], most);
}

}  // namespace splatbus::stream::test
