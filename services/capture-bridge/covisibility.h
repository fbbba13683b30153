#pragma once

#include "capture-bridge/surfel.h"

namespace splatbus::capture_bridge {

struct CullOptions {
  float similar = 0.1F;            ///< within this fraction of the best, the lowest camera index wins
  float min_normal_cosine = 0.5F;  ///< two samples are of one surface only when their normals agree this well
  float edge_penalty = 2.0F;       ///< times the extent of pixels beside a discontinuity, whose colours are blended
};

/// How a sample compares with other cameras' views of its surface point.
struct SurfaceRank {
  std::uint8_t rank = 0;     ///< 1: no camera sees the point better; 2: one does; ... 0: no valid sample
  std::uint8_t seen_by = 0;  ///< how many cameras see the point, this one included
};

/// The rank of camera `own`, whose pixel at a point has `pixel_extent`, among `view_count`: sees(other, found) says
/// whether another one sees it, and its pixel's extent there. Those similar to the smallest come first, by index; the
/// others by extent.
template <class Sees>
SPLATBUS_PORTABLE SurfaceRank rank_among(std::uint32_t view_count, std::uint32_t own, float pixel_extent, float similar,
                                         const Sees& sees) {
  float best = pixel_extent;
  std::uint32_t seen_by = 1;
  std::uint32_t better = 0;
  for (std::uint32_t other = 0; other < view_count; ++other) {
    float found = 0;
    if (other == own || !sees(other, found)) continue;
    ++seen_by;
    best = smaller(found, best);
    if (found < pixel_extent || (found == pixel_extent && other < own)) ++better;
  }
  const float limit = best * (1 + similar);
  if (pixel_extent <= limit) {
    better = 0;
    for (std::uint32_t other = 0; other < own; ++other) {
      float found = 0;
      if (sees(other, found) && found <= limit) ++better;
    }
  }
  return {static_cast<std::uint8_t>(1 + better), static_cast<std::uint8_t>(seen_by)};
}

/// How well cameras see the points of each other's pixels; what it means: rank_across_cameras in stages.h.
class CovisibilityTest {
 public:
  /// `surfels` of all views, `view_pixels` each; `edges` says which lie beside a discontinuity. `movement`: some view
  /// has moved objects.
  SPLATBUS_PORTABLE_MEMBER CovisibilityTest(const PixelView* views, std::uint32_t view_pixels, const Surfel* surfels,
                                            const bool* edges, bool movement, const CullOptions& options)
      : views_(views),
        surfels_(surfels),
        edges_(edges),
        view_pixels_(view_pixels),
        movement_(movement),
        options_(options) {}

  /// Of a camera's own sample: the longest extent of its pixel on the surface, metres of the round; more beside an
  /// edge. Smaller is better.
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER float own_extent(std::uint32_t own, std::size_t pixel) const {
    const PixelView& camera = views_[own];
    const Surfel point = surfels_[pixel];
    const Vec3 to_camera = camera.centre - point.position;
    const float depth_m = -(camera.camera_from_world * to_camera).z;
    return extent(camera, depth_m, to_camera, dot(point.normal, to_camera)) * penalty(pixel) *
           growth(own, point.object_id);
  }

  /// True when the camera faces a sample of view `own`, and its own pixel there holds a sample of the same surface;
  /// then `pixel_extent` is what its pixel there takes of it.
  SPLATBUS_PORTABLE_MEMBER bool sees(std::uint32_t index, std::uint32_t own, const Surfel& sample,
                                     float& pixel_extent) const {
    const Surfel point = movement_ ? moved(sample, own, index) : sample;
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
    const std::size_t pixel =
        std::size_t{index} * view_pixels_ + static_cast<std::size_t>(y) * camera.width + static_cast<std::size_t>(x);
    const Surfel surfel = surfels_[pixel];
    if (surfel.footprint_m == 0 || surfel.object_id != point.object_id) return false;
    if (dot(point.normal, surfel.normal) < options_.min_normal_cosine) return false;
    const float pixel_m = extent(camera, local.z, to_camera, facing);
    const Vec3 offset = surfel.position - point.position;
    if (fabsf(dot(offset, point.normal)) > kPlaneTolerance * pixel_m) return false;
    if (dot(offset, offset) > kLateralTolerance * kLateralTolerance * pixel_m * pixel_m) return false;
    pixel_extent = pixel_m * penalty(pixel) * growth(index, point.object_id);
    return true;
  }

 private:
  static constexpr float kPlaneTolerance = 0.5F;  // pixel extents off the tangent plane
  // Pixel extents on the plane: a pixel's centre is at most 0.71 from any point in it.
  static constexpr float kLateralTolerance = 1.5F;

  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER static float extent(const PixelView& camera, float depth_m,
                                                             const Vec3& to_camera, float facing) {
    return depth_m * length(to_camera) / (camera.fx * facing);
  }

  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER float penalty(std::size_t pixel) const {
    return edges_[pixel] ? options_.edge_penalty : 1;
  }

  /// Of an object, from a view to the round.
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER float growth(std::uint32_t view, std::uint32_t object_id) const {
    if (!movement_) return 1;
    const MovedObject* const object = find_moved(views_[view], object_id);
    return object == nullptr ? 1 : object->round_from_view.scale;
  }

  SPLATBUS_PORTABLE_MEMBER static void apply(const math::Similarity& motion, Surfel& point) {
    point.position = transformed(motion, point.position);
    point.normal = motion.rotation * point.normal;
  }

  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER Surfel moved(Surfel point, std::uint32_t from, std::uint32_t to) const {
    if (const MovedObject* object = find_moved(views_[from], point.object_id)) apply(object->round_from_view, point);
    if (const MovedObject* object = find_moved(views_[to], point.object_id)) apply(object->view_from_round, point);
    return point;
  }

  const PixelView* views_;
  const Surfel* surfels_;
  const bool* edges_;
  std::uint32_t view_pixels_;
  bool movement_;
  CullOptions options_;
};

}  // namespace splatbus::capture_bridge
