#include <cuda_runtime.h>

#include <algorithm>

#include "bench/peaks.h"
#include "device/buffer.h"
#include "device/check.h"

namespace splatbus::bench {
namespace {

using device::check;

constexpr int kTrials = 10;
constexpr int kThreads = 256, kBlocksPerProcessor = 8, kChains = 8, kRounds = 8192;

__global__ void multiply_add_kernel(float factor, float term, float* sink) {
  float x[kChains];
#pragma unroll
  for (int k = 0; k < kChains; ++k) x[k] = 0.1F * k + threadIdx.x;
#pragma unroll 32
  for (int n = 0; n < kRounds; ++n) {
#pragma unroll
    for (int k = 0; k < kChains; ++k) x[k] = fmaf(x[k], factor, term);
  }
  float sum = 0.0F;
#pragma unroll
  for (int k = 0; k < kChains; ++k) sum += x[k];
  sink[blockIdx.x * kThreads + threadIdx.x] = sum;
}

/// Shortest of some trials, seconds; the first ones wake the clocks.
template <class Body>
double best_seconds(const Body& body) {
  cudaEvent_t begin = nullptr, end = nullptr;
  check(cudaEventCreate(&begin), "making an event");
  check(cudaEventCreate(&end), "making an event");
  float best_ms = 1e9F;
  for (int trial = 0; trial < kTrials; ++trial) {
    float milliseconds = 0.0F;
    check(cudaEventRecord(begin), "timing");
    body();
    check(cudaEventRecord(end), "timing");
    check(cudaEventSynchronize(end), "timing");
    check(cudaEventElapsedTime(&milliseconds, begin, end), "timing");
    best_ms = std::min(best_ms, milliseconds);
  }
  cudaEventDestroy(begin);
  cudaEventDestroy(end);
  return 1e-3 * best_ms;
}

}  // namespace

Peaks measure_cuda_peaks() {
  Peaks peaks;
  {
    constexpr std::size_t kBytes = std::size_t{512} << 20U;  // far beyond the second-level cache
    device::Buffer<char> from(kBytes), to(kBytes);
    from.clear(nullptr);
    const double seconds = best_seconds([&] {
      check(cudaMemcpyAsync(to.data(), from.data(), kBytes, cudaMemcpyDeviceToDevice), "copying on the device");
    });
    peaks.bytes_per_s = 2.0 * kBytes / seconds;
  }
  int device = 0, processors = 0;
  check(cudaGetDevice(&device), "asking for the device");
  check(cudaDeviceGetAttribute(&processors, cudaDevAttrMultiProcessorCount, device), "asking for multiprocessors");
  const int blocks = kBlocksPerProcessor * processors;
  device::Buffer<float> sink(static_cast<std::size_t>(blocks) * kThreads);
  const double seconds = best_seconds([&] {
    multiply_add_kernel<<<blocks, kThreads>>>(0.999F, 0.001F, sink.data());
    check(cudaGetLastError(), "multiplying and adding");
  });
  peaks.operations_per_s = 1.0 * blocks * kThreads * kChains * kRounds / seconds;
  return peaks;
}

}  // namespace splatbus::bench
