#pragma once

#include <span>
#include <vector>

#include "capture-bridge/input_view.h"
#include "capture-bridge/surface.h"

namespace splatbus::capture_bridge {

struct CullOptions {
  int cameras_per_surface = 1;     ///< this many cameras keep their samples of one surface point, the best ones
  float similar = 0.1F;            ///< within this fraction of the best, the lowest camera index wins
  float min_normal_cosine = 0.5F;  ///< two samples are of one surface only when their normals agree this well
  float edge_penalty = 2.0F;       ///< quality of pixels beside a discontinuity, whose colours are blended
};

/// Samples per square metre that are left at each pixel's surface point after culling; 0 where the pixel's own sample
/// is culled or there is none. Row-major, one vector a view.
using KeptDensity = std::vector<std::vector<float>>;

/// Culls samples across cameras. At a surface point every camera that sees it is ranked by depth / (focal length *
/// cosine), the longest extent of its pixel on the surface: small is near and not oblique. The best
/// `cameras_per_surface` keep their samples; the ranking depends on nothing but the point, so that neighbouring samples
/// of different cameras agree on it: no surface is covered twice, none is left out. A camera sees a point where its own
/// pixel there holds a valid sample of the same object on the same tangent plane. Objects that moved between the views'
/// frames are compared at their places in each view.
[[nodiscard]] KeptDensity cull_across_cameras(Views views, std::span<const ViewSurface> surfaces,
                                              const CullOptions& options);

/// p_round = transform * p_view for the objects of `view` that stand elsewhere in the round's frame.
[[nodiscard]] ObjectTransforms round_from_view(const ObjectTransforms& view_objects,
                                               const ObjectTransforms& round_objects);

}  // namespace splatbus::capture_bridge
