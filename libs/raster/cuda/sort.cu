#include <cub/device/device_radix_sort.cuh>

#include "raster/cuda/kernels.h"
#include "raster/cuda/sort_key.h"

namespace splatbus::raster::cuda {
namespace {

__global__ void find_offsets_kernel(WorkspaceView w) {
  const std::uint32_t k = blockIdx.x * blockDim.x + threadIdx.x;
  const std::uint32_t count = min(w.counts->isects, w.isect_capacity);
  if (k >= count) return;
  const SortKey key(w);
  const std::uint64_t tile = key.tile(w.isect_ids[1][k]);
  if (k == 0 || key.tile(w.isect_ids[1][k - 1]) != tile) w.tile_offsets[tile].x = k;
  if (k + 1 == count || key.tile(w.isect_ids[1][k + 1]) != tile) w.tile_offsets[tile].y = k + 1;
}

}  // namespace

std::size_t sort_scratch_bytes(std::uint32_t isect_capacity) {
  std::size_t bytes = 0;
  cub::DoubleBuffer<std::uint64_t> keys;
  cub::DoubleBuffer<std::uint32_t> entries;
  check(cub::DeviceRadixSort::SortPairs(nullptr, bytes, keys, entries, static_cast<int>(isect_capacity)),
        "sizing the sort");
  return bytes;
}

void launch_sort(const WorkspaceView& w, cudaStream_t stream) {
  const auto tiles = static_cast<std::uint32_t>(w.tiles_x * w.tiles_y * w.batch);
  if (tiles == 0) return;
  check(cudaMemsetAsync(w.tile_offsets, 0, sizeof(uint2) * tiles, stream), "clearing the tile offsets");
  if (w.isect_capacity == 0) return;
  const SortKey key(w);
  std::size_t bytes = w.sort_scratch_bytes;
  cub::DoubleBuffer<std::uint64_t> keys(w.isect_ids[0], w.isect_ids[1]);
  cub::DoubleBuffer<std::uint32_t> entries(w.flatten_ids[0], w.flatten_ids[1]);
  check(cub::DeviceRadixSort::SortPairs(w.sort_scratch, bytes, keys, entries, static_cast<int>(w.isect_capacity), 0,
                                        key.depth_bits + key.tile_bits, stream),
        "sorting");
  if (keys.selector == 0) {
    // An even number of passes: small pictures only.
    check(cudaMemcpyAsync(w.isect_ids[1], w.isect_ids[0], sizeof(std::uint64_t) * w.isect_capacity,
                          cudaMemcpyDeviceToDevice, stream),
          "moving sorted intersections");
    check(cudaMemcpyAsync(w.flatten_ids[1], w.flatten_ids[0], sizeof(std::uint32_t) * w.isect_capacity,
                          cudaMemcpyDeviceToDevice, stream),
          "moving sorted intersections");
  }
  constexpr int kThreads = 256;
  find_offsets_kernel<<<(w.isect_capacity + kThreads - 1) / kThreads, kThreads, 0, stream>>>(w);
  check(cudaGetLastError(), "finding tile offsets");
}

}  // namespace splatbus::raster::cuda
