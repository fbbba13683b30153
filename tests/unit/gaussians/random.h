#pragma once

#include <cmath>
#include <cstdint>
#include <filesystem>
#include <glm/glm.hpp>
#include <glm/gtc/constants.hpp>
#include <random>
#include <string>

#include "gaussians/light.h"
#include "gaussians/model.h"

namespace splatbus::test {

/// The same values on every machine: the distributions of <random> are not.
class Random {
 public:
  explicit Random(std::uint32_t seed) : engine_(seed) {}
  float uniform(float low, float high) {
    return low + (high - low) * static_cast<float>(engine_() >> 8U) * (1.0F / 16777216.0F);
  }
  glm::vec3 vector(float low, float high) { return {uniform(low, high), uniform(low, high), uniform(low, high)}; }
  glm::vec3 direction() {
    const float z = uniform(-1, 1), phi = uniform(0, glm::two_pi<float>()), r = std::sqrt(1 - z * z);
    return {r * std::cos(phi), r * std::sin(phi), z};
  }
  glm::quat rotation() { return glm::angleAxis(uniform(-3, 3), direction()); }
  Rigid rigid() { return {rotation(), vector(-5, 5)}; }
  Light light() {
    Light light;
    for (glm::vec3& coefficient : light.ambient_sh) coefficient = vector(-0.3F, 0.3F);
    light.ambient_sh[0] = vector(1, 2);
    light.sun_direction = direction();
    light.sun_irradiance = vector(0, 3);
    light.background = vector(0, 1);
    return light;
  }
  GaussiansBuffer gaussians(ParameterLayout layout, std::size_t count) {
    GaussiansBuffer out(layout, count);
    for (float& value : out.parameters) value = uniform(-1, 1);
    for (std::size_t i = 0; i < count; ++i) {
      const glm::vec3 n = direction(), point = vector(-1, 1);
      for (int axis = 0; axis < 3; ++axis) {
        out.normal[static_cast<std::size_t>(axis) * out.stride() + i] = n[axis];
        out.surface_point[static_cast<std::size_t>(axis) * out.stride() + i] = point[axis];
      }
      out.visibility[i] = uniform(0, 1);
      out.object_id[i] = engine_() % 4;
      out.flags[i] = engine_() % 2;
      out.gaussian_id[i] = 1000 + i;
    }
    return out;
  }

 private:
  std::mt19937 engine_;
};

/// A folder that is gone when the test is over.
class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::string pattern = (std::filesystem::temp_directory_path() / "splatbus-test-XXXXXX").string();
    if (mkdtemp(pattern.data()) == nullptr) throw std::runtime_error("no temporary folder");
    path_ = pattern;
  }
  ~TemporaryFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  [[nodiscard]] std::string file(const std::string& name) const { return (path_ / name).string(); }

 private:
  std::filesystem::path path_;
};

}  // namespace splatbus::test
