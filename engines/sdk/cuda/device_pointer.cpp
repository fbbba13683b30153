#include "sdk/cuda/device_pointer.h"

#include <cuda_runtime_api.h>
#include <fmt/format.h>

#include "device/extent.h"

namespace splatbus::engine_sdk::cuda {

std::string pointer_problem(const void* address, std::size_t bytes) {
  cudaPointerAttributes attributes{};
  const cudaError_t status = cudaPointerGetAttributes(&attributes, address);
  if (status != cudaSuccess) {
    static_cast<void>(cudaGetLastError());  // the next call shall not find it
    return fmt::format("its data cannot be looked up as CUDA memory: {}", cudaGetErrorString(status));
  }
  if (attributes.type != cudaMemoryTypeDevice && attributes.type != cudaMemoryTypeManaged) {
    return "its data is not in CUDA memory, as it says";
  }
  if (attributes.device != 0) return fmt::format("its data is on CUDA device {}, not on the first", attributes.device);
  // A copy that leaves its allocation is a fault, after which this process has no device any more.
  if (const std::size_t held = device::extent_at(address, bytes); held < bytes) {
    return fmt::format("its data has {} bytes of CUDA memory, where {} are said to be", held, bytes);
  }
  return {};
}

}  // namespace splatbus::engine_sdk::cuda
