#pragma once

#include "capture-bridge/pixel_view.h"

namespace splatbus::capture_bridge {

/// What culling and thinning read of a pixel, together in half a cache line: the lookups jump about.
struct alignas(16) Texel {
  Vec3 position;          ///< world, in the view's frame
  float footprint_m = 0;  ///< 0: no valid sample; negative: beside a discontinuity
  Vec3 normal;            ///< unit
  std::uint32_t object_id = 0;
};

struct CullOptions {
  float similar = 0.1F;            ///< within this fraction of the best, the lowest camera index wins
  float min_normal_cosine = 0.5F;  ///< two samples are of one surface only when their normals agree this well
  float edge_penalty = 2.0F;       ///< quality of pixels beside a discontinuity, whose colours are blended
};

/// How a sample compares with other cameras' views of its surface point.
struct SurfaceRank {
  std::uint8_t rank = 0;     ///< 1: no camera sees the point better; 2: one does; ... 0: no valid sample
  std::uint8_t seen_by = 0;  ///< how many cameras see the point, this one included
};

/// The rank of camera `own`, that sees a point with `quality`, among `view_count`: sees(other, found) says whether
/// another one sees it, and how well. Those similar to the best come first, by index; the others by quality.
template <class Sees>
SPLATBUS_PORTABLE SurfaceRank rank_among(std::uint32_t view_count, std::uint32_t own, float quality, float similar,
                                         const Sees& sees) {
  float best = quality;
  std::uint32_t seen_by = 1;
  std::uint32_t better = 0;
  for (std::uint32_t other = 0; other < view_count; ++other) {
    float found = 0;
    if (other == own || !sees(other, found)) continue;
    ++seen_by;
    best = smaller(found, best);
    if (found < quality || (found == quality && other < own)) ++better;
  }
  const float limit = best * (1 + similar);
  if (quality <= limit) {
    better = 0;
    for (std::uint32_t other = 0; other < own; ++other) {
      float found = 0;
      if (sees(other, found) && found <= limit) ++better;
    }
  }
  return {static_cast<std::uint8_t>(1 + better), static_cast<std::uint8_t>(seen_by)};
}

/// How well cameras see the points of each other's pixels; what it means: culling.h.
class Sight {
 public:
  /// `texels` of all views, at each view's first_pixel. `movement`: some view has moved objects.
  SPLATBUS_PORTABLE Sight(const PixelView* views, const Texel* texels, bool movement, const CullOptions& options)
      : views_(views), texels_(texels), movement_(movement), options_(options) {}

  /// Quality of a camera's own sample: the longest extent of its pixel on the surface, metres. Smaller is better.
  [[nodiscard]] SPLATBUS_PORTABLE float own_quality(std::uint32_t own, const Texel& point) const {
    const PixelView& camera = views_[own];
    const Vec3 to_camera = camera.centre - point.position;
    const float depth_m = -(camera.camera_from_world * to_camera).z;
    return extent(camera, depth_m, to_camera, dot(point.normal, to_camera)) * penalty(point);
  }

  /// True when the camera faces a sample of view `own`, and its own pixel there holds a sample of the same surface;
  /// then `quality` is how well it sees the point.
  SPLATBUS_PORTABLE bool sees(std::uint32_t index, std::uint32_t own, const Texel& sample, float& quality) const {
    const Texel point = movement_ ? moved(sample, own, index) : sample;
    const PixelView& camera = views_[index];
    const Vec3 to_camera = camera.centre - point.position;
    const float facing = dot(point.normal, to_camera);
    if (!(facing > 0)) return false;
    const Vec3 local = camera.camera_from_world * (point.position - camera.centre);
    if (local.z < camera.near_m) return false;
    const float x = camera.fx * local.x / local.z + camera.cx;
    const float y = camera.fy * local.y / local.z + camera.cy;
    if (!(x >= 0 && y >= 0 && x < static_cast<float>(camera.width) && y < static_cast<float>(camera.height))) {
      return false;
    }
    const Texel texel =
        texels_[camera.first_pixel + static_cast<std::size_t>(y) * camera.width + static_cast<std::size_t>(x)];
    if (texel.footprint_m == 0 || texel.object_id != point.object_id) return false;
    if (dot(point.normal, texel.normal) < options_.min_normal_cosine) return false;
    const float pixel_m = extent(camera, local.z, to_camera, facing);
    const Vec3 offset = texel.position - point.position;
    if (fabsf(dot(offset, point.normal)) > kPlaneTolerance * pixel_m) return false;
    if (dot(offset, offset) > kLateralTolerance * kLateralTolerance * pixel_m * pixel_m) return false;
    quality = pixel_m * penalty(texel);
    return true;
  }

 private:
  static constexpr float kPlaneTolerance = 0.5F;  // pixel extents off the tangent plane
  // Pixel extents on the plane: a pixel's centre is at most 0.71 from any point in it.
  static constexpr float kLateralTolerance = 1.5F;

  [[nodiscard]] SPLATBUS_PORTABLE static float extent(const PixelView& camera, float depth_m, const Vec3& to_camera,
                                                      float facing) {
    return depth_m * length(to_camera) / (camera.fx * facing);
  }

  [[nodiscard]] SPLATBUS_PORTABLE float penalty(const Texel& texel) const {
    return texel.footprint_m < 0 ? options_.edge_penalty : 1;
  }

  SPLATBUS_PORTABLE static void apply(const math::Rigid& motion, Texel& point) {
    point.position = transformed(motion, point.position);
    point.normal = motion.rotation * point.normal;
  }

  [[nodiscard]] SPLATBUS_PORTABLE Texel moved(Texel point, std::uint32_t from, std::uint32_t to) const {
    if (const MovedObject* object = find_moved(views_[from], point.object_id)) apply(object->round_from_view, point);
    if (const MovedObject* object = find_moved(views_[to], point.object_id)) apply(object->view_from_round, point);
    return point;
  }

  const PixelView* views_;
  const Texel* texels_;
  bool movement_;
  CullOptions options_;
};

}  // namespace splatbus::capture_bridge
