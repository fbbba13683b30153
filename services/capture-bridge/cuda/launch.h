#pragma once

#include <cuda_runtime.h>

#include <cstdint>

#include "device/buffer.h"

namespace splatbus::capture_bridge::cuda {

constexpr std::uint32_t kThreads = 256;

inline std::uint32_t blocks_for(std::uint32_t items) {
  return (items + kThreads - 1) / kThreads;
}

/// Index of this thread's item.
__device__ inline std::uint32_t item_of_thread() {
  return blockIdx.x * blockDim.x + threadIdx.x;
}

inline void check_launch(const char* what) {
  device::check(cudaGetLastError(), what);
}

/// Runs a CUB algorithm, `call(scratch, bytes)`, with as much scratch as it asks for.
template <class Call>
void run_cub(device::Buffer<std::byte>& scratch, const char* what, const Call& call) {
  std::size_t bytes = 0;
  device::check(call(nullptr, bytes), what);
  if (scratch.size() < bytes) scratch.resize(bytes);
  device::check(call(scratch.data(), bytes), what);
}

}  // namespace splatbus::capture_bridge::cuda
