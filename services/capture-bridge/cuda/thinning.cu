#include <thrust/iterator/counting_iterator.h>
#include <thrust/iterator/transform_iterator.h>

#include <cub/device/device_radix_sort.cuh>
#include <cub/device/device_reduce.cuh>
#include <cub/device/device_scan.cuh>

#include "capture-bridge/cuda/kernels.h"
#include "capture-bridge/cuda/launch.h"

namespace splatbus::capture_bridge::cuda {
namespace {

struct BoxOf {
  const float* position;
  __device__ Box operator()(std::uint32_t i) const {
    const Vec3 p = load3(position, i);
    return {p, p};
  }
};

struct Unite {
  __device__ Box operator()(const Box& a, const Box& b) const { return united(a, b); }
};

struct ToDouble {
  __host__ __device__ double operator()(float value) const { return value; }
};

__global__ void morton_kernel(Survivors survivors, const Box* bounds, std::uint64_t* codes, std::uint32_t* index) {
  const std::uint32_t i = item_of_thread();
  if (i >= survivors.count) return;
  codes[i] = morton_code(morton_cube(bounds->low, bounds->high), load3(survivors.position, i));
  index[i] = i;
}

/// How many of the largest points are kept for sure: the first number at which the next one is not above the rest's
/// area per point.
__global__ void certain_kernel(const float* sorted, const double* sums, std::uint32_t count, std::uint32_t budget,
                               std::uint32_t* certain) {
  const std::uint32_t c = item_of_thread();
  if (c >= budget) return;
  const std::uint32_t next = count - 1 - c;
  if (c + 1 < budget && sorted[next] > area_per_point(sums[next], c, budget)) return;
  atomicMin(certain, c);
}

__global__ void share_kernel(const float* area_m2, const std::uint32_t* order, const double* sums, std::uint32_t count,
                             std::uint32_t budget, const std::uint32_t* certain, std::uint64_t* shares) {
  const std::uint32_t i = item_of_thread();
  if (i >= count) return;
  const auto threshold = static_cast<float>(area_per_point(sums[count - 1 - *certain], *certain, budget));
  shares[i] = share_of(area_m2[order[i]], threshold);
}

/// A point is kept when the sum of shares reaches a new whole number with it.
__global__ void keep_kernel(const std::uint32_t* order, const std::uint64_t* shares, const std::uint64_t* sums,
                            std::uint32_t count, std::uint32_t budget, std::uint32_t* kept, std::uint32_t* kept_count) {
  const std::uint32_t i = item_of_thread();
  if (i >= count) return;
  const std::uint64_t sum = kFirstShare + sums[i];
  const std::uint64_t before = (sum - shares[i]) >> kShareBits;
  const std::uint64_t after = sum >> kShareBits;
  if (after > before && before < budget) kept[before] = order[i];
  if (i + 1 == count) *kept_count = static_cast<std::uint32_t>(after < budget ? after : budget);
}

}  // namespace

void launch_morton_order(const Survivors& survivors, ThinningMemory& m, cudaStream_t stream) {
  const auto count = static_cast<int>(survivors.count);
  run_cub(m.scratch, "bounding the samples", [&](void* bytes, std::size_t& size) {
    return cub::DeviceReduce::TransformReduce(bytes, size, thrust::counting_iterator<std::uint32_t>(0), m.bounds.data(),
                                              count, Unite(), BoxOf{survivors.position}, Box(), stream);
  });
  morton_kernel<<<blocks_for(survivors.count), kThreads, 0, stream>>>(survivors, m.bounds.data(), m.codes.data(),
                                                                      m.index.data());
  check_launch("computing Morton codes");
  run_cub(m.scratch, "sorting the samples", [&](void* bytes, std::size_t& size) {
    return cub::DeviceRadixSort::SortPairs(bytes, size, m.codes.data(), m.codes_sorted.data(), m.index.data(),
                                           m.order.data(), count, 0, kMortonBits, stream);
  });
}

void launch_thinning(const Survivors& survivors, std::uint32_t budget, ThinningMemory& m, std::uint32_t* kept_count,
                     cudaStream_t stream) {
  const auto count = static_cast<int>(survivors.count);
  run_cub(m.scratch, "sorting the areas", [&](void* bytes, std::size_t& size) {
    return cub::DeviceRadixSort::SortKeys(bytes, size, survivors.area_m2, m.areas_sorted.data(), count, 0, 32, stream);
  });
  run_cub(m.scratch, "summing the areas", [&](void* bytes, std::size_t& size) {
    return cub::DeviceScan::InclusiveSum(bytes, size,
                                         thrust::make_transform_iterator(m.areas_sorted.data(), ToDouble()),
                                         m.area_sums.data(), count, stream);
  });
  device::check(cudaMemsetAsync(m.certain.data(), 0xFF, sizeof(std::uint32_t), stream), "clearing a count");
  certain_kernel<<<blocks_for(budget), kThreads, 0, stream>>>(m.areas_sorted.data(), m.area_sums.data(),
                                                              survivors.count, budget, m.certain.data());
  check_launch("finding the area per sample");
  share_kernel<<<blocks_for(survivors.count), kThreads, 0, stream>>>(survivors.area_m2, m.order.data(),
                                                                     m.area_sums.data(), survivors.count, budget,
                                                                     m.certain.data(), m.shares.data());
  check_launch("sharing out the budget");
  run_cub(m.scratch, "summing the shares", [&](void* bytes, std::size_t& size) {
    return cub::DeviceScan::InclusiveSum(bytes, size, m.shares.data(), m.share_sums.data(), count, stream);
  });
  keep_kernel<<<blocks_for(survivors.count), kThreads, 0, stream>>>(
      m.order.data(), m.shares.data(), m.share_sums.data(), survivors.count, budget, m.kept.data(), kept_count);
  check_launch("thinning");
}

}  // namespace splatbus::capture_bridge::cuda
