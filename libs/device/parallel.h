#pragma once

// Included by sources that run on either device and are written once (splatbus_single_source() in CMake): compiled by
// nvcc in a build with CUDA, as C++ in one without. What runs for an item is a functor whose operator() is
// SPLATBUS_PORTABLE (math/portable.h) and that holds plain numbers and pointers to memory of the stream's device.

#include <thrust/execution_policy.h>
#include <thrust/for_each.h>
#include <thrust/iterator/counting_iterator.h>
#include <thrust/system/tbb/execution_policy.h>

#include <cstddef>
#include <cstdint>
#include <utility>

#include "device/memory.h"
#include "math/portable.h"
#ifdef __CUDACC__
#include <thrust/system/cuda/execution_policy.h>
#endif

namespace splatbus::device {

/// Thrust's scratch memory, in the order of a stream.
class ScratchAllocator {
 public:
  using value_type = char;
  explicit ScratchAllocator(StreamView stream) : stream_(stream) {}
  [[nodiscard]] char* allocate(std::ptrdiff_t bytes) {
    return static_cast<char*>(device::allocate(stream_, static_cast<std::size_t>(bytes)));
  }
  void deallocate(char* memory, std::size_t) { device::deallocate(stream_, memory); }

 private:
  StreamView stream_;
};

/// Calls run(policy) with Thrust's execution policy for the stream: run is a generic lambda that calls algorithms of
/// Thrust with it. On CUDA they are enqueued; those that return a value have waited for it. Throws what Thrust throws.
template <class Run>
decltype(auto) with_policy([[maybe_unused]] StreamView stream, Run&& run) {
#ifdef __CUDACC__
  if (stream.on_cuda()) {
    ScratchAllocator scratch(stream);
    return std::forward<Run>(run)(thrust::cuda::par_nosync(scratch).on(stream.cuda));
  }
#endif
  return std::forward<Run>(run)(thrust::tbb::par);
}

/// Calls f(i) for each i of [0, count), in any order, many at a time.
template <class Functor>
void for_each_index(StreamView stream, std::uint32_t count, Functor f) {
  if (count == 0) return;
  with_policy(stream, [&](auto&& policy) {
    thrust::for_each_n(policy, thrust::make_counting_iterator(std::uint32_t{0}), count, f);
  });
}

/// Adds to a counter that all items share; the host's functors run on several threads too.
template <class T>
SPLATBUS_PORTABLE T atomic_add(T* counter, T value) {
#ifdef __CUDA_ARCH__
  return atomicAdd(counter, value);
#else
  return __atomic_fetch_add(counter, value, __ATOMIC_RELAXED);
#endif
}

}  // namespace splatbus::device
