#pragma once

#include "capture-bridge/culling_math.h"

namespace splatbus::capture_bridge {

/// linear_from_srgb of i / 255.
struct LinearTable {
  float value[256];
};

/// A pixel's linear colour without the background's share of it.
SPLATBUS_PORTABLE Vec3 without_background(const LinearTable& linear, const std::uint8_t* rgba, const Vec3& background) {
  // Below this a pixel is mostly background, and dividing by it amplifies noise.
  constexpr float kLeastCoverage = 0.25F;
  const Vec3 blended{linear.value[rgba[0]], linear.value[rgba[1]], linear.value[rgba[2]]};
  const float coverage = static_cast<float>(rgba[3]) / 255.0F;
  if (rgba[3] == 255 || coverage < kLeastCoverage) return blended;
  const Vec3 own = (blended - background * (1 - coverage)) * (1.0F / coverage);
  return {clamped(own.x, 0, 1), clamped(own.y, 0, 1), clamped(own.z, 0, 1)};
}

/// Where the sample's point is in the round's frame.
SPLATBUS_PORTABLE Vec3 position_in_round(const PixelView& view, const Texel& texel) {
  const MovedObject* moved = find_moved(view, texel.object_id);
  return moved == nullptr ? texel.position : transformed(moved->round_from_view, texel.position);
}

SPLATBUS_PORTABLE Vec3 normal_in_round(const PixelView& view, const Texel& texel) {
  const MovedObject* moved = find_moved(view, texel.object_id);
  return moved == nullptr ? texel.normal : moved->round_from_view.rotation * texel.normal;
}

/// Surface that a sample stands for when the best `cameras_per_surface` cameras keep theirs: the winners' footprints
/// are about the same; they share the surface.
SPLATBUS_PORTABLE float area_of(const Texel& texel, const SurfaceRank& rank, int cameras_per_surface) {
  const int seen_by = rank.seen_by;
  return texel.footprint_m * texel.footprint_m /
         static_cast<float>(cameras_per_surface < seen_by ? cameras_per_surface : seen_by);
}

}  // namespace splatbus::capture_bridge
