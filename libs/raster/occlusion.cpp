#include "raster/occlusion.h"

#include <algorithm>
#include <cmath>

namespace splatbus::raster {

bool Occlusion::hides(const FrustumCamera& pinhole, const math::Similarity& camera_from_page,
                      const PageBounds& bounds) const {
  // As page_frustum() has it.
  constexpr float kReach = 3.3300F, kSlack_px = 1.5F, kCare = 1.01F;
  float nearest = INFINITY, left = INFINITY, right = -INFINITY, top = INFINITY, bottom = -INFINITY;
  for (unsigned corner = 0; corner < 8; ++corner) {
    const math::Vec3 of_page{(corner & 1U) != 0 ? bounds.high.x : bounds.low.x,
                             (corner & 2U) != 0 ? bounds.high.y : bounds.low.y,
                             (corner & 4U) != 0 ? bounds.high.z : bounds.low.z};
    const math::Vec3 p = math::transformed(camera_from_page, of_page);
    if (!(p.z > pinhole.near_m)) return false;
    nearest = std::min(nearest, p.z);
    left = std::min(left, p.x / p.z);
    right = std::max(right, p.x / p.z);
    top = std::min(top, p.y / p.z);
    bottom = std::max(bottom, p.y / p.z);
  }
  const float scale_m = camera_from_page.scale * bounds.max_scale_m;
  const auto reach_px = [&](float focal_px, float max_tan) {
    return kReach * (scale_m * focal_px * std::sqrt(1 + max_tan * max_tan) / nearest + std::sqrt(pinhole.blur_px2)) +
           kSlack_px;
  };
  const float reach_x = reach_px(pinhole.fx, pinhole.max_tan_x), reach_y = reach_px(pinhole.fy, pinhole.max_tan_y);
  const auto tile = [&](float pixel, std::uint32_t tiles) {
    const float side = static_cast<float>(tile_side);
    return static_cast<std::uint32_t>(std::clamp(std::floor(pixel / side), 0.0F, static_cast<float>(tiles - 1)));
  };
  if (tiles_x == 0 || tiles_y == 0) return false;
  const std::uint32_t x0 = tile(pinhole.fx * left + pinhole.cx - reach_x, tiles_x),
                      x1 = tile(pinhole.fx * right + pinhole.cx + reach_x, tiles_x),
                      y0 = tile(pinhole.fy * top + pinhole.cy - reach_y, tiles_y),
                      y1 = tile(pinhole.fy * bottom + pinhole.cy + reach_y, tiles_y);
  for (std::uint32_t y = y0; y <= y1; ++y) {
    for (std::uint32_t x = x0; x <= x1; ++x) {
      if (!(nearest > kCare * depth_m[y * tiles_x + x])) return false;
    }
  }
  return true;
}

}  // namespace splatbus::raster
