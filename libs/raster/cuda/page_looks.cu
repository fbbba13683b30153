#include <cub/block/block_reduce.cuh>

#include "raster/cuda/kernels.h"
#include "raster/cuda/range_lanes.cuh"
#include "raster/cuda/srgb.cuh"

namespace splatbus::raster::cuda {
namespace {

constexpr int kThreads = 128, kLanes = 32;

/// Sums over what counts of a tile.
struct TileError {
  float sum, pixels;

  __device__ TileError operator+(const TileError& other) const { return {sum + other.sum, pixels + other.pixels}; }
};

/// Of a thread's pixels of the tile.
__device__ TileError error_of(const LookPictures& pictures, const WorkspaceView& w, int view, int x0, int y0) {
  const std::size_t pixels = static_cast<std::size_t>(w.width) * w.height;
  const float* const rendered = w.color + 3 * pixels * view;
  const std::uint8_t* const mask = pictures.masks.of(view, pixels);
  const std::uint8_t* const target = pictures.targets[view];
  TileError error{0.0F, 0.0F};
  for (int k = threadIdx.x; k < kTileSize * kTileSize; k += kThreads) {
    const int x = x0 + k % kTileSize, y = y0 + k / kTileSize;
    if (x >= w.width || y >= w.height) continue;
    const std::size_t at = static_cast<std::size_t>(y) * w.width + x;
    if (mask != nullptr && mask[at] != 0) continue;
    float sum = 0.0F;
    for (int c = 0; c < 3; ++c) {
      const float shown = display(fminf(fmaxf(rendered[c * pixels + at], 0.0F), 1.0F), pictures.encode_srgb);
      sum += fabsf(shown - (1.0F / 255.0F) * static_cast<float>(target[4 * at + c]));
    }
    if (!(sum >= 0.0F)) continue;
    error.sum += (1.0F / 3.0F) * sum;
    error.pixels += 1.0F;
  }
  return error;
}

/// One block a tile.
__global__ void __launch_bounds__(kThreads)
    look_kernel(DeviceGaussians gaussians, WorkspaceView w, LookPictures pictures, PageSums* sums, int pages) {
  using Reduce = cub::BlockReduce<TileError, kThreads>;
  __shared__ typename Reduce::TempStorage scratch;
  __shared__ float mean;
  const int tiles = w.tiles_x * w.tiles_y, tile = static_cast<int>(blockIdx.x), view = tile / tiles;
  const int in_view = tile - view * tiles;
  const uint2 range = w.tile_offsets[tile];
  if (range.x >= range.y || pictures.targets[view] == nullptr) return;
  const TileError all = Reduce(scratch).Reduce(
      error_of(pictures, w, view, in_view % w.tiles_x * kTileSize, in_view / w.tiles_x * kTileSize),
      [](const TileError& a, const TileError& b) { return a + b; });
  if (threadIdx.x == 0) mean = all.pixels > 0.0F ? all.sum / all.pixels : -1.0F;
  __syncthreads();
  if (mean < 0.0F) return;
  std::uint32_t end = range.x;
  for (int patch = 0; patch < kPatches; ++patch) end = max(end, w.patch_end[kPatches * tile + patch]);
  end = min(end, range.y);
  const int lane = threadIdx.x % kLanes;
  for (std::uint32_t begin = range.x + threadIdx.x - lane; begin < end; begin += kThreads) {
    const std::uint32_t k = begin + lane;
    const unsigned present = __ballot_sync(0xFFFFFFFFU, k < end);
    if (k >= end) continue;
    const std::uint32_t page = index_of_row(w.listed, w.flatten_ids[1][k] & kRowMask) >> gaussians.page_shift;
    // One lane adds for all that have its page.
    const unsigned same = __match_any_sync(present, page);
    if (lane != __ffs(static_cast<int>(same)) - 1) continue;
    const auto pairs = static_cast<std::uint32_t>(__popc(same));
    PageSums& of = sums[static_cast<std::size_t>(view) * pages + page];
    atomicAdd(&of.pairs, pairs);
    atomicAdd(&of.error, mean * static_cast<float>(pairs));
  }
}

}  // namespace

void launch_page_looks(const DeviceGaussians& gaussians, const WorkspaceView& workspace, const LookPictures& pictures,
                       PageSums* sums, int pages, cudaStream_t stream) {
  const std::size_t bytes =
      sizeof(PageSums) * static_cast<std::size_t>(workspace.batch) * static_cast<std::size_t>(pages);
  check(cudaMemsetAsync(sums, 0, bytes, stream), "clearing the pages' sums");
  const int tiles = workspace.tiles_x * workspace.tiles_y * workspace.batch;
  if (tiles == 0) return;
  look_kernel<<<static_cast<unsigned>(tiles), kThreads, 0, stream>>>(gaussians, workspace, pictures, sums, pages);
  check(cudaGetLastError(), "looking at pages");
}

}  // namespace splatbus::raster::cuda
