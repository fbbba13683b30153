#pragma once

#include <gtest/gtest.h>

#include <memory>
#include <utility>

#include "gaussians/light.h"
#include "sim/projection.h"
#include "sim/renderer.h"

namespace splatbus::sim {

/// One context for all tests of a program: making one takes a while.
inline const std::shared_ptr<GlContext>& shared_context() {
  static const auto context = std::make_shared<GlContext>();
  return context;
}

/// Adds an object of one plain colour.
inline void add_plain(Scene& scene, Mesh mesh, const glm::vec3& albedo,
                      const glm::mat4& world_from_object = glm::mat4(1)) {
  Object object;
  object.id = static_cast<std::uint32_t>(scene.objects.size() + 1);
  object.world_from_object = world_from_object;
  object.parts.push_back({.mesh = std::move(mesh), .material = static_cast<int>(scene.materials.size())});
  scene.materials.push_back({.base_color = albedo});
  scene.objects.push_back(std::move(object));
}

/// The light as the viewers' shading model has it.
inline Light to_model(const splatbus_light& light) {
  Light result;
  for (std::size_t k = 0; k < 9; ++k) {
    for (std::size_t c = 0; c < 3; ++c) result.ambient_sh.at(k)[static_cast<int>(c)] = light.ambient_sh[9 * c + k];
  }
  for (int c = 0; c < 3; ++c) {
    result.sun_direction[c] = light.sun_direction[c];
    result.sun_irradiance[c] = light.sun_irradiance[c];
    result.background[c] = light.background[c];
  }
  return result;
}

/// albedo (E(n) + v s max(0, n.l) / pi), gaussians/light.h, as bytes under the sRGB curve.
inline glm::vec3 expected_bytes(const Light& light, const glm::vec3& albedo, const glm::vec3& normal,
                                float visibility) {
  constexpr float kPi = 3.14159265F;
  const float cosine = std::max(0.0F, glm::dot(normal, light.sun_direction));
  const glm::vec3 linear =
      albedo * (ambient_reflected(light, normal) + visibility * cosine / kPi * light.sun_irradiance);
  glm::vec3 bytes;
  for (int c = 0; c < 3; ++c) bytes[c] = 255 * srgb_from_linear(glm::clamp(linear[c], 0.0F, 1.0F));
  return bytes;
}

inline glm::vec3 pixel_bytes(const std::vector<std::uint8_t>& rgba, std::uint32_t width, std::uint32_t x,
                             std::uint32_t y) {
  const std::size_t at = 4 * (std::size_t{y} * width + x);
  return {rgba.at(at), rgba.at(at + 1), rgba.at(at + 2)};
}

}  // namespace splatbus::sim
