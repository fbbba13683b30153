#pragma once

#include "device/sorted.cuh"
#include "raster/cuda/device_scene.h"

namespace splatbus::raster::cuda {

/// Row of object_views of an object, given the ascending ids of all rows but the first.
__device__ inline std::uint16_t object_slot(std::uint32_t id, const std::uint32_t* ids, int id_count) {
  if (id == kWorldFrame) return 0;
  const int at = device::find_sorted(ids, static_cast<std::uint32_t>(id_count), id);
  return at < 0 ? kHiddenSlot : static_cast<std::uint16_t>(1 + at);
}

}  // namespace splatbus::raster::cuda
