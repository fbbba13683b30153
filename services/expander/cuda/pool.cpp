#include "expander/cuda/pool.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdint>
#include <stdexcept>

#include "device/check.h"

namespace splatbus::expander::cuda {

using device::check;

Pool::Pool() {
  int current = 0;
  check(cudaGetDevice(&current), "finding the device");
  cudaMemPool_t pool = nullptr;
  check(cudaDeviceGetDefaultMemPool(&pool, current), "finding the memory pool");
  std::uint64_t everything = UINT64_MAX;
  check(cudaMemPoolSetAttribute(pool, cudaMemPoolAttrReleaseThreshold, &everything), "keeping the memory pool");
}

std::shared_ptr<std::byte> Pool::take(std::size_t bytes, const char* what) {
  Account& account = *account_;
  bytes = std::max<std::size_t>(bytes, 1);
  if (account.held > account.most || bytes > account.most - account.held) {
    throw std::runtime_error(fmt::format("no device memory for {}: {} bytes asked for, {} of at most {} held", what,
                                         bytes, account.held, account.most));
  }
  void* memory = nullptr;
  if (const cudaError_t status = cudaMallocAsync(&memory, bytes, thread_stream()); status != cudaSuccess) {
    static_cast<void>(cudaGetLastError());  // else the next launch is blamed for it
    throw std::runtime_error(fmt::format("no device memory for {}: {} bytes asked for, {} held: {}", what, bytes,
                                         account.held, cudaGetErrorString(status)));
  }
  account.held += bytes;
  return {static_cast<std::byte*>(memory), [bytes, held = account_](std::byte* owned) {
            held->held -= bytes;
            cudaFreeAsync(owned, thread_stream());
          }};
}

}  // namespace splatbus::expander::cuda
