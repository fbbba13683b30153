#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "capture-bridge/culling_math.h"
#include "capture-bridge/pixel_views.h"

namespace splatbus::capture_bridge {

/// Why pixels of an engine's frame were not taken as samples.
struct DropCounts {
  std::size_t not_finite = 0;  ///< position, normal or object id is NaN or infinite
  std::size_t bad_normal = 0;  ///< not of unit length
  std::size_t off_ray = 0;     ///< the position does not project to its own pixel, or lies outside near and far

  [[nodiscard]] std::size_t broken() const { return not_finite + bad_normal + off_ray; }
  DropCounts& operator+=(const DropCounts& other);
  bool operator==(const DropCounts&) const = default;
  [[nodiscard]] std::string text() const;
};

struct SurfaceOptions {
  float min_cosine = 0.1F;  ///< between the normal and the direction to the camera
};

/// What the views of a round see, pixel by pixel; each view's pixels row-major at its first_pixel.
struct RoundSurface {
  std::vector<float> depth_m;  ///< along the camera's z; 0: no surface
  std::vector<float> cosine;   ///< between normal and direction to the camera
  std::vector<std::uint32_t> object_id;
  std::vector<Texel> texels;        ///< of samples that are seen at min_cosine or better
  std::vector<DropCounts> dropped;  ///< a view
};

/// Checks every pixel and measures its footprint: the square root of the surface area a pixel stands for, from the
/// steps to its neighbours' positions. A step that leaves the surface (another object, or longer than twice what the
/// tangent plane says) is replaced by the tangent plane's. Views in host memory. Uses all TBB workers.
[[nodiscard]] RoundSurface analyse_surfaces(const PixelViews& views, const SurfaceOptions& options);

}  // namespace splatbus::capture_bridge
