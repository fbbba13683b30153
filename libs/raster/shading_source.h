#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace splatbus {
struct Light;
struct Rigid;
}  // namespace splatbus

namespace splatbus::raster {

/// A LightSource as the rasterisers' inner loops take it: in the camera's frame, where lengths are the world's whatever
/// the scale of an object, so that one table serves all objects. A point light is a spot whose cone is everywhere.
struct alignas(16) ShadingSource {
  float position[3];
  float inverse_range;  ///< per metre
  float direction[3];   ///< unit; directional: towards the light; else its axis, away from it
  float cos_outer;
  float intensity_over_pi[3];
  float inverse_cone;              ///< 1 / (cos_inner - cos_outer)
  const std::uint8_t* visibility;  ///< by index, 255 sees all of it; null: it is not shadowed
  bool directional;
};

/// No Gaussian is nearer to a source than this, as in incident(); of an object's own metres.
constexpr float kMinSourceDistance_m = 0.01F;

/// Rows of visibility as GaussiansView's, for the same device as `values`.
struct VisibilityRows {
  const std::uint8_t* values = nullptr;
  std::size_t stride = 0;
  std::uint32_t rows = 0;
};

/// Those of a light. Throws std::invalid_argument for more than kMaxLightSources.
[[nodiscard]] std::vector<ShadingSource> shading_sources(const Light& light, const Rigid& camera_from_world,
                                                         const VisibilityRows& visibility);

}  // namespace splatbus::raster
