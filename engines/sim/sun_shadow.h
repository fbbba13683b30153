#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <vector>

#include "sim/depth_maps.h"

namespace splatbus::sim {

/// The sun's depth maps: one over everything that casts a shadow, or, where its texels would be too wide, kCascades of
/// them, the first ones about the camera whose picture is drawn. What lies outside is lit. Of those about a camera the
/// last few are kept: pictures of a viewer's surroundings, and of several viewers', take turns.
class SunShadow {
 public:
  /// `casters` and `receivers` bound the scene in the world, over all time.
  SunShadow(int size, const Bounds& casters, const Bounds& receivers);

  /// Draws what would show anything else than it does, for a picture taken at `eye`.
  void update(GpuScene& scene, const splatbus_light& light, const glm::vec3& eye, const DepthPrograms& program_for);

  /// Sets a lit shading program's shadow uniforms and binds the maps.
  void bind(GLuint program, float softness_m) const;

  [[nodiscard]] bool cascades() const { return cascades_; }
  [[nodiscard]] std::uint64_t times_drawn() const { return times_drawn_; }

 private:
  struct Map {
    splatbus_camera camera{};
    std::uint64_t depth_version = 0;
    std::uint64_t used = 0;  ///< the update that wanted it last
  };
  [[nodiscard]] splatbus_camera camera_of(std::size_t cascade, const glm::vec3& sun_direction,
                                          const glm::vec3& eye) const;
  /// The layer of that camera's map, or of the one that has not been wanted for longest.
  [[nodiscard]] std::size_t layer_for(std::size_t cascade, const splatbus_camera& camera) const;
  void bind_one(GLuint program, float softness_m) const;

  int size_;
  Bounds casters_, receivers_;
  bool cascades_;
  DepthMaps depth_;
  std::vector<Map> maps_;                            ///< by layer
  std::array<std::size_t, kCascades> current_ = {};  ///< layers, of the picture that is drawn
  std::uint64_t updates_ = 0, times_drawn_ = 0;
};

}  // namespace splatbus::sim
