#pragma once

#include <cstddef>

#include "math/portable.h"

namespace splatbus::relight {

constexpr float kMinRadius_texels = 1.5F;  // the map's own resolution
constexpr float kMaxRadius_texels = 24.0F;

/// How a depth map was taken.
enum class Projection { Orthographic, Pinhole };

/// A surface's plane over a depth map, and the filter's ellipse about its point. The plane is linear over the texels:
/// in depth, metres, of an orthographic map; in 1 / depth of a pinhole's.
struct FilterWindow {
  float x = 0, y = 0;  ///< texels
  float plane = 0;
  float slope_x = 0, slope_y = 0;    ///< of `plane`, a texel
  float radius_x = 0, radius_y = 0;  ///< texels
};

/// Share of the texels that the plane lies before, or in, weighted by 1 - (distance / radius)^2; a depth that is no
/// number hides. Texels outside of the map: an orthographic one's count as lit, a pinhole's not at all, for another map
/// has them. Everything but depth is finite, the radii at most kMaxRadius_texels, and the window touches the map,
/// [height][width]. By vectors, in a half to a quarter of the time that lit_share() takes.
[[nodiscard]] float lit_share_on_host(Projection projection, const FilterWindow& w, const float* depth_m, int width,
                                      int height);

/// The same, texel by texel.
SPLATBUS_PORTABLE float lit_share(Projection projection, const FilterWindow& w, const float* depth_m, int width,
                                  int height) {
  const bool pinhole = projection == Projection::Pinhole;
  float hidden = 0, weight = 0;
  const float one_step = 1.0F / w.radius_x;
  const int bottom = static_cast<int>(ceilf(w.y + w.radius_y));
  for (int y = static_cast<int>(floorf(w.y - w.radius_y)); y < bottom; ++y) {
    const float dy = static_cast<float>(y) + 0.5F - w.y;
    const float row_weight = 1.0F - dy * dy / (w.radius_y * w.radius_y);
    if (row_weight <= 0.0F) continue;
    const bool row_inside = y >= 0 && y < height;
    const float* const row = depth_m + static_cast<std::ptrdiff_t>(y) * width;
    const float row_plane = w.plane + w.slope_y * dy;
    const float half = w.radius_x * sqrtf(row_weight);
    const int right = static_cast<int>(ceilf(w.x + half));
    for (int x = static_cast<int>(floorf(w.x - half)); x < right; ++x) {
      const float dx = static_cast<float>(x) + 0.5F - w.x;
      const float across = dx * one_step;
      const float share = math::larger(row_weight - across * across, 0.0F);
      const bool inside = row_inside && x >= 0 && x < width;
      if (inside || !pinhole) weight += share;
      if (!inside) continue;
      const float plane = row_plane + w.slope_x * dx;
      const bool lit = pinhole ? plane * row[x] >= 1.0F : plane <= row[x];
      if (!lit) hidden += share;
    }
  }
  return hidden > 0.0F ? (weight - hidden) / weight : 1.0F;
}

}  // namespace splatbus::relight
