#pragma once

namespace splatbus::relight {

/// A surface's plane over a depth map, in texels across and metres of depth, and the filter's ellipse about its point.
struct FilterWindow {
  float x = 0, y = 0;  ///< texels
  float depth_m = 0;
  float slope_x = 0, slope_y = 0;    ///< metres of depth a texel
  float radius_x = 0, radius_y = 0;  ///< texels
};

/// Share of the texels that the plane lies before, or in, weighted by 1 - (distance / radius)^2; texels outside of the
/// map count as lit. Everything is finite, the radii at most kGreatestRadius_texels, and the window touches the map.
[[nodiscard]] float lit_share(const FilterWindow& window, const float* depth_m, int width, int height);

}  // namespace splatbus::relight
