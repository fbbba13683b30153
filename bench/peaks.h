#pragma once

#include <cstddef>

namespace splatbus::bench {

/// What a machine does at best, measured on the spot.
struct Peaks {
  double bytes_per_s = 0;       ///< read and written, through memory
  double operations_per_s = 0;  ///< fused multiply-adds of single floats
};

/// Of `threads` threads, 0: all cores. Memory: the better of reading, and of changing in place, `bytes` that lie
/// together. Arithmetic: independent chains of Highway's widest vectors.
[[nodiscard]] Peaks measure_cpu_peaks(int threads, std::size_t bytes);

/// Of the current device. Memory: a copy from device memory to device memory. Arithmetic: independent chains in every
/// lane. Throws std::runtime_error naming the CUDA error.
[[nodiscard]] Peaks measure_cuda_peaks();

}  // namespace splatbus::bench
