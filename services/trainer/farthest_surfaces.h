#pragma once

#include <cstddef>
#include <cstdint>

#include "device/stream.h"
#include "gaussians/occlusion.h"

namespace splatbus::trainer {

/// Numbers that find_farthest_surfaces() writes.
[[nodiscard]] inline std::size_t surface_squares(std::uint32_t width, std::uint32_t height) {
  return std::size_t{FarthestSurfaces::squares(width)} * FarthestSurfaces::squares(height);
}

/// FarthestSurfaces::depth_m of a picture whose depth is [height][width], metres along z, 0 where there is no surface.
/// All on the stream's device.
void find_farthest_surfaces(device::StreamView stream, const float* depth_m, std::uint32_t width, std::uint32_t height,
                            float* farthest_m);

}  // namespace splatbus::trainer
