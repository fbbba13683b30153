#pragma once

#include <glm/glm.hpp>

#include "sim/scene.h"

namespace splatbus::sim {

/// No sun, no sky.
inline void make_dark(Lighting& lighting) {
  lighting.ambient = {};
  lighting.sun_irradiance = glm::vec3(0);
}

/// One that never changes, under the next id.
inline void add_source(Lighting& lighting, const splatbus_light_source& source) {
  lighting.sources.push_back({.id = static_cast<std::uint32_t>(lighting.sources.size() + 1),
                              .at = [source](double) { return std::optional(source); }});
}

// Each shines on the floor about (0, 0, 0) from the side of +x.

inline splatbus_light_source directional_source() {
  splatbus_light_source source{};
  source.kind = SPLATBUS_LIGHT_DIRECTIONAL;
  source.casts_shadow = 1;
  source.direction[0] = 0.36F;
  source.direction[1] = 0.8F;
  source.direction[2] = 0.48F;
  source.intensity[0] = 2.0F;
  source.intensity[1] = 3.0F;
  source.intensity[2] = 1.5F;
  return source;
}

inline splatbus_light_source point_source() {
  splatbus_light_source source{};
  source.kind = SPLATBUS_LIGHT_POINT;
  source.casts_shadow = 1;
  source.position[0] = 0.9F;
  source.position[1] = 1.6F;
  source.position[2] = 0.3F;
  source.intensity[0] = 6;
  source.intensity[1] = 5;
  source.intensity[2] = 4;
  source.range_m = 3;
  return source;
}

inline splatbus_light_source spot_source() {
  splatbus_light_source source = point_source();
  source.kind = SPLATBUS_LIGHT_SPOT;
  const glm::vec3 axis = glm::normalize(glm::vec3(-0.8F, -1.6F, -0.3F));
  for (int c = 0; c < 3; ++c) source.direction[c] = axis[c];
  source.range_m = 6;
  source.cos_inner = 0.95F;
  source.cos_outer = 0.75F;
  return source;
}

}  // namespace splatbus::sim
