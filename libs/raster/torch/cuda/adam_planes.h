#pragma once

#include <cuda_runtime_api.h>

#include <cstdint>

namespace splatbus::raster::cuda {

/// Adam on planes [channels][count] with gradients as planes: AdamStep for device memory. All pointers are device
/// pointers.
struct AdamPlanes {
  float* parameters = nullptr;
  const float* gradient = nullptr;
  const std::uint8_t* touched = nullptr;  ///< [count], columns that step
  const float* rates = nullptr;           ///< [channels]
  float* first = nullptr;
  float* second = nullptr;
  std::uint32_t* steps = nullptr;  ///< [count]
  int channels = 0;
  std::int64_t count = 0;
  float beta1 = 0, beta2 = 0, epsilon = 0, lr_half_life_steps = 0, lr_min_factor = 0;
};

/// One launch on `stream`, with no synchronisation.
void launch_adam_planes(const AdamPlanes& adam, cudaStream_t stream);

}  // namespace splatbus::raster::cuda
