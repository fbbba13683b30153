#pragma once

#include <cstddef>
#include <cstdint>

#include "gaussians/frames.h"
#include "math/portable.h"

// A model in pages: up to kPageLanes Gaussians of one frame of reference and one range of a Morton curve, whose
// channels lie in one block ([channels][kRowWords]). A Gaussian's index is page * kPageLanes + lane. Plain structs
// that kernels take as they are. docs/decisions/0085-pages.md says why they are of this size.
namespace splatbus {

#ifndef SPLATBUS_PAGE_SHIFT  // for measurements of other sizes
#define SPLATBUS_PAGE_SHIFT 10
#endif
inline constexpr std::uint32_t kPageShift = SPLATBUS_PAGE_SHIFT;
inline constexpr std::uint32_t kPageLanes = 1U << kPageShift;
inline constexpr std::uint32_t kTierLanes = 256;
/// From one channel of a page to the next. Two lines of cache more than its lanes: at a power of two all channels of a
/// Gaussian share one set of a cache of 4 KiB a way (the step over 208K Gaussians took 1.15 times as long).
inline constexpr std::uint32_t kRowWords = kPageLanes + 32;
/// `page_shift` of Gaussians that do not lie in pages: all indices are of page 0.
inline constexpr std::uint32_t kNoPages = 31;

/// Gaussians first, first + 1, ... of one page.
struct IndexRange {
  std::uint32_t first = 0, count = 0;
  std::uint32_t frame_id = kWorldFrame;  ///< object whose frame they are in
  std::uint32_t frozen = 0;              ///< 1: they are drawn, and a training step leaves them as they are
  bool operator==(const IndexRange&) const = default;
};

/// What a page's Gaussians keep within, in its frame of reference, metres.
struct PageBounds {
  math::Vec3 low{INFINITY, INFINITY, INFINITY}, high{-INFINITY, -INFINITY, -INFINITY};  ///< of the means
  float max_scale_m = 0;  ///< largest standard deviation along any axis
};

/// Takes one more mean in; false for one that is no number, whose Gaussian is not drawn and takes no room.
SPLATBUS_PORTABLE bool include(PageBounds& bounds, const math::Vec3& mean) {
  if (!(math::is_finite(mean.x) && math::is_finite(mean.y) && math::is_finite(mean.z))) return false;
  bounds.low = {math::smaller(mean.x, bounds.low.x), math::smaller(mean.y, bounds.low.y),
                math::smaller(mean.z, bounds.low.z)};
  bounds.high = {math::larger(mean.x, bounds.high.x), math::larger(mean.y, bounds.high.y),
                 math::larger(mean.z, bounds.high.z)};
  return true;
}
SPLATBUS_PORTABLE void include(PageBounds& bounds, const math::Vec3& mean, float max_log_scale) {
  // A scale that is no number makes a Gaussian invisible; larger() leaves it out.
  if (include(bounds, mean)) bounds.max_scale_m = math::larger(expf(max_log_scale), bounds.max_scale_m);
}

/// The half-spaces outside of which nothing shows in a picture, in a page's frame of reference: a Gaussian is outside
/// of one when normal . mean + offset + per_scale * scale < 0.
struct PageFrustum {
  struct HalfSpace {
    math::Vec3 normal;
    float offset = 0, per_scale = 0;
  };
  HalfSpace sides[5];  ///< left, right, top, bottom, near
};

/// Pinhole camera in pixels, and the clamp of tangents that the rasterisers apply to it.
struct FrustumCamera {
  float fx, fy, cx, cy, width, height;
  float near_m;
  float blur_px2;
  float max_tan_x, max_tan_y;  ///< largest |tangent| after the clamp
};

/// Standard deviations at which an opacity of 1 falls below 1/255, sqrt(2 ln 255).
inline constexpr float kReach = 3.3300F;
/// Added to what a Gaussian reaches, for pixels' sides and rounding.
inline constexpr float kReachSlack_px = 1.5F;

/// Exact: what it leaves out shows in no pixel. With the local affine approximation (Zwicker et al. 2001) a Gaussian of
/// standard deviation s at depth z reaches at most r (s fx sqrt(1 + tan_x^2) / z + sqrt(blur)) pixels to the side,
/// with r of kReach. Multiplied by z this is linear in the mean. A point of the page is at camera_from_page * (scale *
/// point).
SPLATBUS_PORTABLE PageFrustum page_frustum(const FrustumCamera& camera, const math::Rigid& camera_from_page,
                                           float scale = 1) {
  const float blur_px = kReach * sqrtf(camera.blur_px2) + kReachSlack_px;
  const math::Mat3 page_from_camera = math::transposed(camera_from_page.rotation);
  const auto side = [&](const math::Vec3& normal, float offset, float per_scale) {
    return PageFrustum::HalfSpace{page_from_camera * normal * scale, dot(normal, camera_from_page.translation) + offset,
                                  scale * per_scale};
  };
  const float scale_x = kReach * camera.fx * sqrtf(1 + camera.max_tan_x * camera.max_tan_x);
  const float scale_y = kReach * camera.fy * sqrtf(1 + camera.max_tan_y * camera.max_tan_y);
  return {{side({camera.fx, 0, camera.cx + blur_px}, 0, scale_x),
           side({-camera.fx, 0, camera.width - camera.cx + blur_px}, 0, scale_x),
           side({0, camera.fy, camera.cy + blur_px}, 0, scale_y),
           side({0, -camera.fy, camera.height - camera.cy + blur_px}, 0, scale_y),
           side({0, 0, 1}, -0.999F * camera.near_m, 0)}};
}

/// False when no Gaussian of the page can show. Rounding is allowed for by a part of 1e-5 of what is summed.
SPLATBUS_PORTABLE bool may_show(const PageFrustum& frustum, const PageBounds& bounds) {
  if (!(bounds.low.x <= bounds.high.x)) return false;
  for (const PageFrustum::HalfSpace& side : frustum.sides) {
    const float x = side.normal.x * (side.normal.x > 0 ? bounds.high.x : bounds.low.x);
    const float y = side.normal.y * (side.normal.y > 0 ? bounds.high.y : bounds.low.y);
    const float z = side.normal.z * (side.normal.z > 0 ? bounds.high.z : bounds.low.z);
    const float reach = side.per_scale * bounds.max_scale_m;
    const float slack = 1e-5F * (fabsf(x) + fabsf(y) + fabsf(z) + fabsf(side.offset));
    if (x + y + z + side.offset + reach + slack < 0) return false;
  }
  return true;
}

}  // namespace splatbus
