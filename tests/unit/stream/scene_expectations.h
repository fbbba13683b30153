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
    EXPECT_LE(angle_between(object.rotation, transform.rigid.rotation), kMaxRotationError_rad);
  }
  const glm::dvec3 sun(got.light.sun_direction), true_sun(want.light.sun_direction);
  EXPECT_LE(glm::length(glm::cross(sun, true_sun)), kMaxSunError_rad);
  EXPECT_GT(glm::dot(sun, true_sun), 0);
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
