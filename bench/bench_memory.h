#pragma once

#ifdef SPLATBUS_HAVE_CUDA
#include <cuda_runtime_api.h>
#endif

#include <fstream>
#include <string>

#include "device/device.h"

namespace splatbus::bench {

/// What is in use of a device's memory: on CUDA by all processes, in MiB; on the CPU by this one.
[[nodiscard]] inline double used_mib(Device device) {
#ifdef SPLATBUS_HAVE_CUDA
  if (device == Device::Cuda) {
    std::size_t free = 0, all = 0;
    cudaMemGetInfo(&free, &all);
    return static_cast<double>(all - free) / 1048576;
  }
#endif
  static_cast<void>(device);
  std::ifstream status("/proc/self/status");
  std::string word;
  while (status >> word) {
    double kib = 0;
    if (word == "VmRSS:" && status >> kib) return kib / 1024;
  }
  return 0;
}

}  // namespace splatbus::bench
