#pragma once

#include <cstdint>
#include <glm/glm.hpp>

#include "sim/source_lights.h"
#include "sim/sun_shadow.h"

namespace splatbus::sim {

struct LitShadingOptions {
  int sun_map_size, source_map_size;  ///< texels a side
  float softness_m;                   ///< radius of the shadows' filter
};

/// What lit pictures need on the GPU besides surfaces: the light, and who sees it.
class LitShading {
 public:
  LitShading(const LitShadingOptions& options, const Scene& scene);

  /// Draws the depth maps that would show anything else, for a picture taken at `eye`.
  void update(GpuScene& scene, const splatbus_light& light, const glm::vec3& eye, const DepthPrograms& program_for);
  /// Of the light that was last updated to.
  [[nodiscard]] ShaderVariant variant(const ShaderVariant& shade) const;
  /// Sets the uniforms of a lit shading program of that variant, and binds its textures.
  void bind(GLuint program, const splatbus_light& light) const;

  [[nodiscard]] std::uint64_t sun_maps_drawn() const { return sun_.times_drawn(); }
  [[nodiscard]] std::uint64_t source_maps_drawn() const { return sources_.maps_drawn(); }

 private:
  float softness_m_;
  SunShadow sun_;
  SourceLights sources_;
  bool has_sources_ = false;
};

}  // namespace splatbus::sim
