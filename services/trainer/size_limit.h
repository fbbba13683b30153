#pragma once

#include <cstdint>

#include "trainer/gaussian_kernels.h"

// docs/decisions/0133-no-larger-than-a-tenth-of-its-distance.md
namespace splatbus::trainer::kernels {

/// Where cameras stand, in the world.
struct Eyes {
  static constexpr std::uint32_t kMost = 16;
  float x_m[kMost], y_m[kMost], z_m[kMost];
  std::uint32_t count = 0;
};
/// A Gaussian of the world or of the far field becomes no larger, in any direction, than `share` of its distance to
/// each of these cameras, and so does its average. Frozen pages stay as they are.
void limit_sizes(StreamView stream, const PagedGaussians& gaussians, const Eyes& eyes, float share);

}  // namespace splatbus::trainer::kernels
