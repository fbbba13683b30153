#pragma once

#include <array>
#include <cstdint>
#include <glm/glm.hpp>
#include <span>
#include <vector>

#include "sim/depth_maps.h"

namespace splatbus::sim {

/// The lights besides the sun on the GPU: a uniform block that lists them, and their depth maps.
class SourceLights {
 public:
  /// Depth maps of `local_size` texels for each face of a point light and for a spot light, of `directional_size` for a
  /// directional one, which has the whole scene, within `bounds`.
  SourceLights(int local_size, int directional_size, const Bounds& bounds);

  /// Lists the sources of `light`, and draws the maps of those that have a new depth version.
  void update(GpuScene& scene, const splatbus_light& light, const DepthPrograms& program_for);

  /// For shading programs with sources.
  void bind() const;

  [[nodiscard]] std::uint64_t maps_drawn() const { return maps_drawn_; }

 private:
  /// Where a source's maps are: layers of its texture, from the first one.
  struct Place {
    std::uint32_t id, kind, maps;
    int first_layer;
    std::uint64_t drawn_version = 0;
    MapCamera camera;  ///< of its first map
  };
  /// As the shader's block is laid out, std140.
  struct Source {
    glm::vec4 position_range, direction_kind, intensity_layer, cone;
    MapCamera map;
  };
  struct Block {
    std::array<Source, SPLATBUS_MAX_LIGHTS> sources;
    std::array<std::int32_t, 4> count;  ///< of point and spot lights, and of all
  };

  void lay_out(std::span<const splatbus_light_source> sources);
  void draw_maps(GpuScene& scene, const splatbus_light& light, Place& place, const DepthPrograms& program_for);

  int local_size_, directional_size_;
  Bounds bounds_;
  DepthMaps local_, directional_;
  GlBuffer buffer_;
  Block block_{};
  std::vector<Place> places_;
  std::uint64_t maps_drawn_ = 0;
};

}  // namespace splatbus::sim
