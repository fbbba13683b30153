#include "expander/cuda/pool.h"

#include <algorithm>
#include <cstdint>

#include "device/check.h"

namespace splatbus::expander::cuda {

using device::check;

std::shared_ptr<std::byte> pooled(std::size_t bytes) {
  void* memory = nullptr;
  check(cudaMallocAsync(&memory, std::max<std::size_t>(bytes, 1), thread_stream()), "allocating device memory");
  return {static_cast<std::byte*>(memory), [](std::byte* owned) { cudaFreeAsync(owned, thread_stream()); }};
}

void keep_pooled_memory() {
  int current = 0;
  check(cudaGetDevice(&current), "finding the device");
  cudaMemPool_t pool = nullptr;
  check(cudaDeviceGetDefaultMemPool(&pool, current), "finding the memory pool");
  std::uint64_t everything = UINT64_MAX;
  check(cudaMemPoolSetAttribute(pool, cudaMemPoolAttrReleaseThreshold, &everything), "keeping the memory pool");
}

}  // namespace splatbus::expander::cuda
