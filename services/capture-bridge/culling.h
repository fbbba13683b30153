#pragma once

#include <span>
#include <vector>

#include "capture-bridge/culling_math.h"
#include "capture-bridge/pixel_views.h"

namespace splatbus::capture_bridge {

/// Ranks samples across cameras; one rank a pixel of `texels`. At a surface point every camera that sees it is ranked
/// by depth / (focal length * cosine), the longest extent of its pixel on the surface: small is near and not oblique.
/// The ranking depends on nothing but the point, so that neighbouring samples of different cameras agree on it: when
/// the samples of rank 1 to k are kept, every surface that is seen by k cameras is covered k times, and none is left
/// out. A camera sees a point where its own pixel there holds a valid sample of the same object on the same tangent
/// plane. Objects that moved between the views' frames are compared at their places in each view.
[[nodiscard]] std::vector<SurfaceRank> rank_across_cameras(const PixelViews& views, std::span<const Texel> texels,
                                                           const CullOptions& options);

}  // namespace splatbus::capture_bridge
