#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "expander/input_samples.h"

namespace splatbus::expander::test {

constexpr float kSpacing = 0.05F;

/// One camera 3 m above the origin that sees an empty floor at y = 0 under it.
inline InputSamples empty_round() {
  InputSamples samples;
  samples.rig_generation = 1;
  samples.cameras = {look_at({0, 3, 0.001F}, {0, 0, 0}, 64, 64, 1.2F)};
  samples.width = samples.height = 64;
  samples.light.sun_direction = {0, 1, 0};
  samples.light.sun_irradiance = {2, 2, 2};
  for (std::uint32_t y = 0; y < 64; ++y) {
    for (std::uint32_t x = 0; x < 64; ++x) {
      const Camera& camera = samples.cameras[0];
      const glm::vec3 through = unproject(camera, static_cast<float>(x) + 0.5F, static_cast<float>(y) + 0.5F, 1);
      samples.depth_m.push_back(3 / (3 - through.y));
    }
  }
  return samples;
}

inline void add_sample(InputSamples& samples, const glm::vec3& position, std::uint32_t object_id = 1,
                       const glm::vec3& normal = {0, 1, 0}) {
  samples.position.push_back(position);
  samples.normal.push_back(normal);
  samples.albedo.emplace_back(0.5F, 0.4F, 0.3F);
  samples.color.emplace_back(0.3F, 0.3F, 0.3F);
  samples.spacing_m.push_back(kSpacing);
  samples.cosine.push_back(0.9F);
  samples.object_id.push_back(object_id);
  samples.camera.push_back(0);
}

/// A square grid of samples of the floor over [low, high) in x and z, shifted by `shift` of a step.
inline void add_floor(InputSamples& samples, float low, float high, float shift = 0.5F) {
  const auto steps = static_cast<int>(std::lround((high - low) / kSpacing));
  for (int x = 0; x < steps; ++x) {
    for (int z = 0; z < steps; ++z) {
      add_sample(samples, {low + (static_cast<float>(x) + shift) * kSpacing, 0,
                           low + (static_cast<float>(z) + shift) * kSpacing});
    }
  }
}

inline InputSamples floor_round(float low, float high, float shift = 0.5F) {
  InputSamples samples = empty_round();
  add_floor(samples, low, high, shift);
  return samples;
}

}  // namespace splatbus::expander::test
