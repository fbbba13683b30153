#pragma once

#include "capture-bridge/neighbour_tree.h"

namespace splatbus::capture_bridge {

/// Neighbours that are looked at: the point itself, and enough to find four on the same side of an edge or a thin
/// sheet.
constexpr int kSearchedNeighbours = 9;

/// What estimate_spacing (spacing.h) says of point i. `normal` is [count, 3].
SPLATBUS_PORTABLE float spacing_of(const Nearest<kSearchedNeighbours>& nearest, const float* normal, std::uint32_t i,
                                   float fallback_m) {
  constexpr int kNeighbours = 4;
  constexpr float kSameSurfaceCosine = 0.5F;
  constexpr float kLargestRatio = 4.0F;
  const Vec3 own_normal = load3(normal, i);
  float sum = 0;
  int neighbours = 0;
  for (int k = 0; k < kSearchedNeighbours; ++k) {
    const bool counts = k < nearest.found && neighbours < kNeighbours && nearest.index[k] != i &&
                        !(dot(load3(normal, nearest.index[k]), own_normal) < kSameSurfaceCosine);
    if (!counts) continue;
    sum += sqrtf(nearest.distance2[k]);
    ++neighbours;
  }
  if (neighbours < 2) return fallback_m;
  const float mean = sum / static_cast<float>(neighbours);
  return clamped(mean, fallback_m / kLargestRatio, fallback_m * kLargestRatio);
}

}  // namespace splatbus::capture_bridge
