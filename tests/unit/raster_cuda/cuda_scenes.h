#pragma once

#include <cuda_runtime.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <random>
#include <string>
#include <vector>

#include "gaussians/model.h"
#include "raster/rasterizer.h"

namespace splatbus::raster::testing {

struct Case {
  const char* name;
  ParameterLayout layout;
  int count;
  std::uint32_t width, height;
  bool antialias;
  bool objects;
  float log_scale;
  float opacity_logit = 0.0F;
  bool depth = false, alpha = false;  ///< with gradients through them
  bool lights = false;                ///< besides the sun, with visibility; object 7 is scaled, object 9 emissive
};

inline std::string case_name(const ::testing::TestParamInfo<Case>& info) {
  return info.param.name;
}

inline GaussiansBuffer random_model(const Case& c, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> normal;
  std::uniform_real_distribution<float> uniform;
  GaussiansBuffer model(c.layout, static_cast<std::size_t>(c.count));
  const std::size_t stride = model.stride();
  for (std::size_t i = 0; i < model.count(); ++i) {
    const auto put = [&](int channel, float value) {
      model.parameters[static_cast<std::size_t>(channel) * stride + i] = value;
    };
    for (int k = 0; k < 3; ++k) {
      put(k, 1.2F * normal(random));
      put(3 + k, c.log_scale + 0.7F * normal(random));
      model.normal[static_cast<std::size_t>(k) * stride + i] = normal(random);
    }
    for (int k = 0; k < 4; ++k) put(6 + k, normal(random));
    put(10, c.opacity_logit + 2.0F * normal(random));
    for (int k = 11; k < c.layout.channels(); ++k)
      put(k, (k < 14 ? 0.5F : 0.1F) * normal(random) + (k < 14 ? 0.4F : 0.0F));
    const float n = std::hypot(model.normal[i], model.normal[stride + i], model.normal[2 * stride + i]);
    for (std::size_t k = 0; k < 3; ++k) model.normal[k * stride + i] /= n;
    model.visibility[i] = uniform(random);
    model.object_id[i] = i % 3 == 0 ? 7U : 0U;
    model.flags[i] = i % 11 == 0 ? kFrozen : 0U;
  }
  return model;
}

inline SceneState random_scene(bool objects) {
  SceneState scene;
  for (std::size_t k = 0; k < 9; ++k)
    scene.light.ambient_sh[k] = glm::vec3(0.8F, 0.7F, 0.9F) / (1.0F + static_cast<float>(k));
  scene.light.sun_direction = glm::normalize(glm::vec3(0.4F, 0.8F, 0.3F));
  scene.light.sun_irradiance = {2.0F, 1.8F, 1.5F};
  scene.light.background = {0.2F, 0.3F, 0.5F};
  if (objects) {
    scene.objects[7] = Rigid{glm::angleAxis(0.7F, glm::normalize(glm::vec3(1, 2, 3))), {0.3F, -0.2F, 0.4F}};
  }
  return scene;
}

inline double largest_difference(const Image& a, const Image& b) {
  double largest = 0;
  for (std::size_t k = 0; k < a.data.size(); ++k) {
    const double difference = std::abs(double{a.data[k]} - b.data[k]);
    largest = std::isfinite(difference) ? std::max(largest, difference) : INFINITY;
  }
  return largest;
}

/// ||a - b|| / ||b|| over channels [first, last) of Gaussians' gradients.
inline double relative_error(const ParameterGradient& a, const ParameterGradient& b, int first, int last) {
  double difference = 0, norm = 0;
  for (int c = first; c < last; ++c) {
    for (std::size_t i = 0; i < a.count; ++i) {
      const std::size_t at = static_cast<std::size_t>(c) * a.stride + i;
      difference += std::pow(a.values[at] - b.values[at], 2);
      norm += std::pow(b.values[at], 2);
    }
  }
  return std::sqrt(difference / std::max(norm, 1e-30));
}

/// The same for any two lists of numbers.
inline double relative_error(const std::vector<float>& a, const std::vector<float>& b) {
  double difference = 0, norm = 0;
  for (std::size_t k = 0; k < b.size(); ++k) {
    difference += std::pow(a[k] - b[k], 2);
    norm += std::pow(b[k], 2);
  }
  return std::sqrt(difference / std::max(norm, 1e-30));
}

inline Image random_image(std::uint32_t width, std::uint32_t height, std::uint32_t channels, std::mt19937& random) {
  Image image(width, height, channels);
  std::normal_distribution<float> normal;
  for (float& value : image.data) value = normal(random);
  return image;
}

/// Skipped where there is no device.
class CudaTest : public ::testing::Test {
 protected:
  void SetUp() override {
    int devices = 0;
    if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) GTEST_SKIP() << "no CUDA device";
  }
};

}  // namespace splatbus::raster::testing
