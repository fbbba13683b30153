#include "device/extent.h"

#include <cuda.h>
#include <cuda_runtime_api.h>

#include <algorithm>
#include <cstdint>
#include <stdexcept>

#include "device/check.h"

namespace splatbus::device {

namespace {

/// The driver's function: a program that links to libcuda does not start where there is none.
decltype(&cuMemGetAddressRange) address_range() {
  constexpr unsigned kVersion = 12000;  // whose signature cuda.h declares under this name
  void* function = nullptr;
  cudaDriverEntryPointQueryResult result{};
  check(cudaGetDriverEntryPointByVersion("cuMemGetAddressRange", &function, kVersion, cudaEnableDefault, &result),
        "looking up cuMemGetAddressRange");
  if (result != cudaDriverEntryPointSuccess) throw std::runtime_error("CUDA: the driver has no cuMemGetAddressRange");
  return reinterpret_cast<decltype(&cuMemGetAddressRange)>(function);
}

}  // namespace

std::size_t extent_at(const void* address, std::size_t bytes) {
  static const auto range_of = address_range();
  const auto start = reinterpret_cast<CUdeviceptr>(address);
  std::size_t held = 0;
  while (held < bytes) {
    CUdeviceptr base = 0;
    std::size_t size = 0;
    if (range_of(&base, &size, start + held) != CUDA_SUCCESS) break;
    held = base + size - start;
  }
  return std::min(held, bytes);
}

}  // namespace splatbus::device
