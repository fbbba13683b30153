#pragma once

#include <cstdint>

#include "gaussians/pages.h"

// What the surfaces of a picture hide of a model in pages. Plain structs that kernels take as they are.
namespace splatbus {

/// Pixels of a square's side.
inline constexpr std::uint32_t kSurfaceSquare_px = 8;

/// How far the farthest surface is that a picture shows in each square of it and in the pixels about the square:
/// metres along z, row after row, infinite where one of them shows none. In memory of the device that reads it, owned
/// by somebody else.
struct FarthestSurfaces {
  const float* depth_m = nullptr;  ///< null: nobody knows

  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER static std::uint32_t squares(std::uint32_t pixels) {
    return (pixels + kSurfaceSquare_px - 1) / kSurfaceSquare_px;
  }
};

/// Of the rounding of a depth, and of how far from its surface a Gaussian comes to lie.
inline constexpr float kHiddenPart = 0.03F, kHiddenMargin_m = 0.05F;

/// Squares that are looked at for one page at most: one that could reach more is taken for seen.
inline constexpr std::uint32_t kMostSquares = 1024;

/// True when all that a page's Gaussians could reach shows surfaces that are nearer than every mean. A camera must
/// have been tried by may_show(); frames as in page_frustum(). What a page is hidden by is the engine's picture: a
/// model whose surfaces let light through looks otherwise without what is behind them.
SPLATBUS_PORTABLE bool is_behind(const FarthestSurfaces& surfaces, const FrustumCamera& camera,
                                 const math::Rigid& camera_from_page, float scale, const PageBounds& bounds) {
  if (surfaces.depth_m == nullptr) return false;
  float left = INFINITY, right = -INFINITY, top = INFINITY, bottom = -INFINITY, nearest_m = INFINITY;
  for (int corner = 0; corner < 8; ++corner) {
    const math::Vec3 of_page{(corner & 1) != 0 ? bounds.high.x : bounds.low.x,
                             (corner & 2) != 0 ? bounds.high.y : bounds.low.y,
                             (corner & 4) != 0 ? bounds.high.z : bounds.low.z};
    const math::Vec3 at = transformed(camera_from_page, of_page * scale);
    if (!(at.z > camera.near_m)) return false;
    nearest_m = math::smaller(at.z, nearest_m);
    const float u = camera.fx * at.x / at.z + camera.cx, v = camera.fy * at.y / at.z + camera.cy;
    left = math::smaller(u, left);
    right = math::larger(u, right);
    top = math::smaller(v, top);
    bottom = math::larger(v, bottom);
  }
  const float blur_px = kReach * sqrtf(camera.blur_px2) + kReachSlack_px;
  const float reach = kReach * scale * bounds.max_scale_m / nearest_m;
  const float reach_x = reach * camera.fx * sqrtf(1 + camera.max_tan_x * camera.max_tan_x) + blur_px;
  const float reach_y = reach * camera.fy * sqrtf(1 + camera.max_tan_y * camera.max_tan_y) + blur_px;
  if (!(math::is_finite(reach_x) && math::is_finite(reach_y))) return false;
  const auto square = [](float pixel, float pixels) {
    return static_cast<std::uint32_t>(math::smaller(math::larger(pixel, 0.0F), pixels - 1)) / kSurfaceSquare_px;
  };
  const std::uint32_t first_column = square(left - reach_x, camera.width),
                      last_column = square(right + reach_x, camera.width);
  const std::uint32_t first_row = square(top - reach_y, camera.height),
                      last_row = square(bottom + reach_y, camera.height);
  if ((last_row - first_row + 1) * (last_column - first_column + 1) > kMostSquares) return false;
  const std::uint32_t columns = FarthestSurfaces::squares(static_cast<std::uint32_t>(camera.width));
  for (std::uint32_t row = first_row; row <= last_row; ++row) {
    for (std::uint32_t column = first_column; column <= last_column; ++column) {
      const float surface_m = surfaces.depth_m[row * columns + column];
      if (!((1 + kHiddenPart) * surface_m + kHiddenMargin_m < nearest_m)) return false;
    }
  }
  return true;
}

}  // namespace splatbus
