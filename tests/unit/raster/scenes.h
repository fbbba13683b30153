#pragma once

#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include "gaussians/camera.h"
#include "gaussians/model.h"
#include "lights.h"
#include "raster/rasterizer.h"

namespace splatbus::raster::testing {

/// Gaussians in vectors, planes as in GaussiansView, with a stride above the count so that a wrong one shows.
struct TestScene {
  ParameterLayout layout;
  std::size_t count = 0, stride = 0;
  std::vector<float> parameters, normal, visibility;
  std::vector<std::uint8_t> light_visibility;  ///< [visibility_rows][visibility_stride]; empty: none
  std::size_t visibility_stride = 0;
  std::uint32_t visibility_rows = 1;
  std::vector<std::uint32_t> object_id, flags;
  SceneState state;

  TestScene(const ParameterLayout& of, std::size_t n) : layout(of), count(n), stride(n + 5) {
    parameters.resize(static_cast<std::size_t>(layout.channels()) * stride);
    normal.resize(3 * stride);
    visibility.resize(stride);
    object_id.resize(stride);
    flags.resize(stride);
  }
  float& at(int channel, std::size_t i) { return parameters[static_cast<std::size_t>(channel) * stride + i]; }
  [[nodiscard]] GaussiansView view() const {
    GaussiansView out;
    out.layout = layout;
    out.count = count;
    out.stride = stride;
    out.parameters = parameters.data();
    out.normal = normal.data();
    out.visibility = visibility.data();
    out.visibility_u8 = light_visibility.empty() ? nullptr : light_visibility.data();
    out.visibility_stride = visibility_stride;
    out.visibility_rows = visibility_rows;
    out.object_id = object_id.data();
    out.flags = flags.data();
    return out;
  }
};

inline Camera test_camera(std::uint32_t width, std::uint32_t height) {
  Camera camera = look_at({0.3F, 0.4F, 3.0F}, {0.05F, -0.1F, 0}, width, height, 0.9F);
  camera.cx += 1.3F;  // off centre, so that nothing may assume otherwise
  camera.cy -= 0.7F;
  camera.fx *= 1.1F;
  return camera;
}

struct SceneRecipe {
  float spread = 1;  ///< half side of the cube of means
  float scale_low = 0.05F, scale_high = 0.3F;
  float logit_low = -2, logit_high = 3;
  bool objects = true;  ///< a third each: static, two transformed objects
};

/// A random scene; the same seed gives the same scene on every machine (only raw generator output is used).
inline TestScene random_scene(const ParameterLayout& layout, std::size_t count, const SceneRecipe& recipe,
                              std::uint32_t seed) {
  std::mt19937 generator(seed);
  const auto uniform = [&](float low, float high) {
    return low + (high - low) * static_cast<float>(generator() >> 8U) * (1.0F / 16777216.0F);
  };
  TestScene scene(layout, count);
  for (std::size_t i = 0; i < count; ++i) {
    for (int c = 0; c < 3; ++c) scene.at(c, i) = uniform(-recipe.spread, recipe.spread);
    for (int c = 3; c < 6; ++c) scene.at(c, i) = std::log(uniform(recipe.scale_low, recipe.scale_high));
    for (int c = 6; c < 10; ++c) scene.at(c, i) = uniform(-1, 1);
    scene.at(10, i) = uniform(recipe.logit_low, recipe.logit_high);
    for (int c = 11; c < layout.channels(); ++c) scene.at(c, i) = uniform(-0.3F, 0.3F);
    if (layout.appearance == Appearance::Transfer) {
      for (int c = 11; c < 14; ++c) scene.at(c, i) = uniform(0.05F, 0.9F);
      for (int c = 14; c < 41; ++c) scene.at(c, i) *= 0.2F;
    }
    glm::vec3 normal(uniform(-1, 1), uniform(-1, 1), uniform(-1, 1));
    normal = glm::normalize(normal);
    for (int c = 0; c < 3; ++c) scene.normal[static_cast<std::size_t>(c) * scene.stride + i] = normal[c];
    scene.visibility[i] = uniform(0, 1);
    if (recipe.objects) scene.object_id[i] = static_cast<std::uint32_t>(generator() % 3) * 7;
  }
  Light& light = scene.state.light;
  for (std::size_t k = 0; k < 9; ++k) {
    for (int c = 0; c < 3; ++c) light.ambient_sh[k][c] = uniform(-0.2F, 0.2F) + (k == 0 ? 1.5F : 0.0F);
  }
  light.sun_direction = glm::normalize(glm::vec3(0.4F, 0.8F, 0.3F));
  light.sun_irradiance = {2.5F, 2.2F, 1.9F};
  light.background = {0.1F, 0.2F, 0.35F};
  if (recipe.objects) {
    scene.state.objects[7] = Rigid{glm::normalize(glm::quat(0.8F, 0.3F, -0.4F, 0.2F)), {0.2F, -0.1F, 0.3F}};
    scene.state.objects[14] = Rigid{glm::normalize(glm::quat(-0.2F, 0.5F, 0.7F, -0.1F)), {-0.3F, 0.2F, -0.2F}};
  }
  return scene;
}

/// Visibility of the sun and the first `rows` - 1 sources, by chance.
inline void add_visibility(TestScene& scene, std::uint32_t rows, std::uint32_t seed) {
  scene.visibility_rows = rows;
  scene.visibility_stride = scene.count + 3;
  scene.light_visibility = random_bytes(rows * scene.visibility_stride, seed);
}

inline ParameterLayout transfer_layout() {
  return {Appearance::Transfer, 0};
}
inline ParameterLayout radiance_layout(int degree) {
  return {Appearance::Radiance, degree};
}

}  // namespace splatbus::raster::testing
