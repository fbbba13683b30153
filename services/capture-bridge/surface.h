#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <string>
#include <vector>

#include "capture-bridge/input_view.h"

namespace splatbus::capture_bridge {

/// Why pixels of an engine's frame were not taken as samples.
struct DropCounts {
  std::size_t not_finite = 0;  ///< position, normal or object id is NaN or infinite
  std::size_t bad_normal = 0;  ///< not of unit length
  std::size_t off_ray = 0;     ///< the position does not project to its own pixel, or lies outside near and far
  std::size_t grazing = 0;     ///< seen too obliquely, or from behind; usual, not an engine's mistake

  [[nodiscard]] std::size_t broken() const { return not_finite + bad_normal + off_ray; }
  DropCounts& operator+=(const DropCounts& other);
  [[nodiscard]] std::string text() const;
};

struct SurfaceOptions {
  float min_cosine = 0.1F;  ///< between the normal and the direction to the camera
};

/// What an input view sees, pixel by pixel; row-major as the view.
struct ViewSurface {
  std::vector<float> footprint_m;  ///< metres between neighbouring samples on the surface; 0: no valid sample
  std::vector<float> cosine;       ///< between normal and direction to the camera
  std::vector<float> depth_m;      ///< along the camera's z; 0: no surface
  std::vector<std::uint32_t> object_id;
  std::vector<std::uint8_t> edge;  ///< 1: beside a depth or object discontinuity, where colours are blended
  DropCounts dropped;
};

/// Checks every pixel and measures its footprint: the square root of the surface area a pixel stands for, from the
/// steps to its neighbours' positions. A step that leaves the surface (another object, or longer than twice what the
/// tangent plane says) is replaced by the tangent plane's.
[[nodiscard]] ViewSurface analyse_surface(const InputView& view, const SurfaceOptions& options);

}  // namespace splatbus::capture_bridge
