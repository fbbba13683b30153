#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "capture-bridge/input_view.h"
#include "capture-bridge/surface.h"

namespace splatbus::capture_bridge {

struct CullOptions {
  float similar = 0.1F;            ///< within this fraction of the best, the lowest camera index wins
  float min_normal_cosine = 0.5F;  ///< two samples are of one surface only when their normals agree this well
  float edge_penalty = 2.0F;       ///< quality of pixels beside a discontinuity, whose colours are blended
};

/// How a view's samples compare with other cameras' views of the same surface points; row-major as the view.
struct SurfaceRanks {
  std::vector<std::uint8_t> rank;     ///< 1: no camera sees the point better; 2: one does; ... 0: no valid sample
  std::vector<std::uint8_t> seen_by;  ///< how many cameras see the point, this one included
};

/// Ranks samples across cameras. At a surface point every camera that sees it is ranked by depth / (focal length *
/// cosine), the longest extent of its pixel on the surface: small is near and not oblique. The ranking depends on
/// nothing but the point, so that neighbouring samples of different cameras agree on it: when the samples of rank 1 to
/// k are kept, every surface that is seen by k cameras is covered k times, and none is left out. A camera sees a point
/// where its own pixel there holds a valid sample of the same object on the same tangent plane. Objects that moved
/// between the views' frames are compared at their places in each view. At most 255 views.
[[nodiscard]] std::vector<SurfaceRanks> rank_across_cameras(Views views, std::span<const ViewSurface> surfaces,
                                                            const CullOptions& options);

/// p_round = transform * p_view for the objects of `view` that stand elsewhere in the round's frame.
[[nodiscard]] ObjectTransforms round_from_view(const ObjectTransforms& view_objects,
                                               const ObjectTransforms& round_objects);

}  // namespace splatbus::capture_bridge
