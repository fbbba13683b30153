#pragma once

#include <cstdint>

#include "device/stream.h"
#include "math/portable.h"

namespace splatbus::capture_bridge {

/// A picture of positions as an engine gives it, in the memory of a device.
struct SeenPositions {
  const float* position;           ///< [height][width][4], world, metres
  const std::uint32_t* object_id;  ///< [height][width], 0 where there is no surface
  std::uint32_t width, height;
  math::Vec3 eye, axis;  ///< world; of the camera, its z
};

/// Adds the number of pixels with a surface nearer than `near_m` along the camera's z to `*count`, in order on the
/// stream.
void count_near(device::StreamView stream, const SeenPositions& seen, float near_m, std::uint32_t* count);

}  // namespace splatbus::capture_bridge
