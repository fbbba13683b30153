#include <cub/device/device_radix_sort.cuh>

#include "raster/cuda/kernels.h"
#include "raster/cuda/sort_key.h"

namespace splatbus::raster::cuda {
namespace {

__global__ void find_ranges_kernel(WorkspaceView w) {
  const std::uint32_t pair = blockIdx.x * blockDim.x + threadIdx.x;
  const std::uint32_t count = min(*w.pair_count, w.pair_capacity);
  if (pair >= count) return;
  const SortKey key(w);
  const std::uint64_t tile = key.tile(w.pair_keys[1][pair]);
  if (pair == 0 || key.tile(w.pair_keys[1][pair - 1]) != tile) w.tile_range[tile].x = pair;
  if (pair + 1 == count || key.tile(w.pair_keys[1][pair + 1]) != tile) w.tile_range[tile].y = pair + 1;
}

}  // namespace

std::size_t sort_scratch_bytes(std::uint32_t pair_capacity) {
  std::size_t bytes = 0;
  cub::DoubleBuffer<std::uint64_t> keys;
  cub::DoubleBuffer<std::uint32_t> entries;
  check(cub::DeviceRadixSort::SortPairs(nullptr, bytes, keys, entries, static_cast<int>(pair_capacity)),
        "sizing the sort");
  return bytes;
}

void launch_sort(const WorkspaceView& w, cudaStream_t stream) {
  const auto tiles = static_cast<std::uint32_t>(w.tiles_x * w.tiles_y * w.batch);
  check(cudaMemsetAsync(w.tile_range, 0, sizeof(uint2) * tiles, stream), "clearing the tile ranges");
  if (w.pair_capacity == 0 || tiles == 0) return;
  const SortKey key(w);
  std::size_t bytes = w.sort_scratch_bytes;
  cub::DoubleBuffer<std::uint64_t> keys(w.pair_keys[0], w.pair_keys[1]);
  cub::DoubleBuffer<std::uint32_t> entries(w.pair_entries[0], w.pair_entries[1]);
  check(cub::DeviceRadixSort::SortPairs(w.sort_scratch, bytes, keys, entries, static_cast<int>(w.pair_capacity), 0,
                                        key.depth_bits + key.tile_bits, stream),
        "sorting");
  if (keys.selector == 0) {
    // An even number of passes: small pictures only.
    check(cudaMemcpyAsync(w.pair_keys[1], w.pair_keys[0], sizeof(std::uint64_t) * w.pair_capacity,
                          cudaMemcpyDeviceToDevice, stream),
          "moving sorted pairs");
    check(cudaMemcpyAsync(w.pair_entries[1], w.pair_entries[0], sizeof(std::uint32_t) * w.pair_capacity,
                          cudaMemcpyDeviceToDevice, stream),
          "moving sorted pairs");
  }
  constexpr int kThreads = 256;
  find_ranges_kernel<<<(w.pair_capacity + kThreads - 1) / kThreads, kThreads, 0, stream>>>(w);
  check(cudaGetLastError(), "finding tile ranges");
}

}  // namespace splatbus::raster::cuda
