#include "raster/cuda/gaussian_channels.cuh"
#include "raster/cuda/kernels.h"
#include "raster/cuda/object_slot.cuh"

namespace splatbus::raster::cuda {
namespace {

constexpr int kThreads = 256, kCopyThreads = 512;

/// One block, so that all of it has read `turn` before that changes.
__global__ void copy_tables_kernel(const uint4* ring, int slots, uint4* tables, std::size_t words, std::uint32_t* turn,
                                   StepCounts* counts) {
  constexpr unsigned kCounts = sizeof(StepCounts) / sizeof(std::uint32_t);
  static_assert(kCounts <= kCopyThreads);
  if (threadIdx.x < kCounts) reinterpret_cast<std::uint32_t*>(counts)[threadIdx.x] = 0;
  const uint4* from = ring + *turn % slots * words;
  for (std::size_t k = threadIdx.x; k < words; k += kCopyThreads) tables[k] = __ldcv(from + k);
  __syncthreads();
  if (threadIdx.x == 0) *turn += 1;
}

__global__ void object_slots_kernel(DeviceGaussians gaussians, const std::uint32_t* ids, int id_count,
                                    std::uint16_t* slots) {
  const int i = blockIdx.x * kThreads + threadIdx.x;
  if (i < gaussians.count) slots[i] = object_slot(gaussians.object_id[index_offset(i, gaussians)], ids, id_count);
}

}  // namespace

void launch_copy_tables(const std::byte* ring, int slots, std::byte* tables, std::size_t bytes, std::uint32_t* turn,
                        StepCounts* counts, cudaStream_t stream) {
  copy_tables_kernel<<<1, kCopyThreads, 0, stream>>>(reinterpret_cast<const uint4*>(ring), slots,
                                                     reinterpret_cast<uint4*>(tables), bytes / sizeof(uint4), turn,
                                                     counts);
  check(cudaGetLastError(), "copying tables");
}

void launch_clear_counts(const WorkspaceView& workspace, cudaStream_t stream) {
  check(cudaMemsetAsync(workspace.counts, 0, sizeof(StepCounts), stream), "clearing the counts");
}

void launch_object_slots(const DeviceGaussians& gaussians, const std::uint32_t* object_ids, int id_count,
                         std::uint16_t* slots, cudaStream_t stream) {
  if (gaussians.count == 0) return;
  const auto blocks = static_cast<unsigned>((gaussians.count + kThreads - 1) / kThreads);
  object_slots_kernel<<<blocks, kThreads, 0, stream>>>(gaussians, object_ids, id_count, slots);
  check(cudaGetLastError(), "object slots");
}

}  // namespace splatbus::raster::cuda
