#include "raster/shading_source.h"

#include <numbers>
#include <stdexcept>
#include <string>

#include "gaussians/light.h"

namespace splatbus::raster {

std::vector<ShadingSource> shading_sources(const Light& light, const Rigid& camera_from_world,
                                           const VisibilityRows& visibility) {
  if (light.sources.size() > kMaxLightSources) {
    throw std::invalid_argument("rasterizer: more than " + std::to_string(kMaxLightSources) + " light sources");
  }
  std::vector<ShadingSource> out;
  out.reserve(light.sources.size());
  for (const LightSource& source : light.sources) {
    const glm::vec3 position = camera_from_world * source.position;
    const glm::vec3 direction = camera_from_world.rotation * source.direction;
    const glm::vec3 intensity = source.intensity * std::numbers::inv_pi_v<float>;
    const bool spot = source.kind == LightKind::Spot;
    const std::size_t row = 1 + out.size();
    const bool shadowed = visibility.values != nullptr && row < visibility.rows;
    out.push_back({.position = {position.x, position.y, position.z},
                   .inverse_range = 1 / source.range_m,
                   .direction = {direction.x, direction.y, direction.z},
                   .cos_outer = spot ? source.cos_outer : -2,
                   .intensity_over_pi = {intensity.x, intensity.y, intensity.z},
                   .inverse_cone = spot ? 1 / (source.cos_inner - source.cos_outer) : 1,
                   .visibility = shadowed ? visibility.values + row * visibility.stride : nullptr,
                   .directional = source.kind == LightKind::Directional});
  }
  return out;
}

}  // namespace splatbus::raster
