#pragma once

#include <cuda_runtime_api.h>

#include <cstdint>

#include "raster/cuda/kernels.h"
#include "trainer/cuda/column_kernels.h"

// Adaptive density control on the device: device pointers; launches on `stream`, nothing waits. Throw
// std::runtime_error naming the CUDA error.
namespace splatbus::trainer::cuda {

/// chosen[i], of [count], becomes 1 where the mean gradient of the projected mean is at least `threshold`, 0
/// elsewhere.
void launch_choose_dense(const ModelPlanes& planes, const raster::cuda::ScreenStatistics& statistics,
                         std::uint32_t count, float threshold, std::uint8_t* chosen, cudaStream_t stream);

struct SplitOptions {
  float max_clone_log_scale = 0;  ///< larger ones are split
  float log_split_factor = 0;     ///< what is taken off their log-scales
  std::uint32_t seed = 0;
};
/// Column first + k is a copy of columns[k], k < count. Where their scale asks for a split, both are drawn from what
/// they were, and become smaller.
void launch_split(const ModelPlanes& planes, const std::uint32_t* columns, std::uint32_t first, std::uint32_t count,
                  const SplitOptions& options, cudaStream_t stream);

}  // namespace splatbus::trainer::cuda
