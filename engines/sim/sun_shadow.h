#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <vector>

#include "sim/depth_maps.h"

namespace splatbus::sim {

/// The sun's depth maps: one over everything that casts a shadow, or, where its texels would be too wide, kCascades of
/// them, the first ones about the camera whose picture is drawn. What lies outside is lit.
class SunShadow {
 public:
  /// `casters` and `receivers` bound the scene in the world, over all time.
  SunShadow(int size, const Bounds& casters, const Bounds& receivers);

  /// Draws what would show anything else than it does, for a picture taken at `eye`.
  void update(GpuScene& scene, const splatbus_light& light, const glm::vec3& eye, const DepthPrograms& program_for);

  /// Sets a lit shading program's shadow uniforms and binds the maps.
  void bind(GLuint program, float softness_m) const;

  [[nodiscard]] bool cascades() const { return maps_of_.size() > 1; }
  [[nodiscard]] std::uint64_t times_drawn() const { return times_drawn_; }

 private:
  struct Map {
    splatbus_camera camera{};
    std::uint64_t depth_version = 0;
  };
  [[nodiscard]] splatbus_camera camera_of(std::size_t map, const glm::vec3& sun_direction, const glm::vec3& eye) const;
  void bind_one(GLuint program, float softness_m) const;

  int size_;
  Bounds casters_, receivers_;
  DepthMaps depth_;
  std::vector<Map> maps_of_;
  std::uint64_t times_drawn_ = 0;
};

}  // namespace splatbus::sim
