#include "raster/cuda/kernels.h"
#include "raster/unmodelled.h"

namespace splatbus::raster::cuda {
namespace {

constexpr int kLanes = 32, kThreads = 256, kSide = kUnmodelledSide, kEach = kSide * kSide / kLanes;

/// One warp a square.
__global__ void __launch_bounds__(kThreads)
    mask_kernel(WorkspaceView w, const float* const* depths, const std::uint8_t* const* masks, float opacity) {
  const int lane = threadIdx.x % kLanes, view = blockIdx.y;
  const int columns = (w.width + kSide - 1) / kSide, rows = (w.height + kSide - 1) / kSide;
  const int square = static_cast<int>(blockIdx.x * (kThreads / kLanes) + threadIdx.x / kLanes);
  if (square >= columns * rows) return;
  const std::size_t plane = static_cast<std::size_t>(view) * w.width * w.height;
  const float* const depth = depths[view];
  const std::uint8_t* const own = masks == nullptr ? nullptr : masks[view];
  const int x = square % columns * kSide + lane % kSide, y0 = square / columns * kSide + lane / kSide;
  bool inside[kEach], lacks[kEach];
  std::size_t at[kEach];
  float sum = 0.0F, surface = 0.0F;
#pragma unroll
  for (int k = 0; k < kEach; ++k) {
    const int y = y0 + k * (kLanes / kSide);
    at[k] = static_cast<std::size_t>(y) * w.width + x;
    inside[k] = x < w.width && y < w.height;
    lacks[k] = false;
    if (!inside[k] || depth == nullptr || !shows_surface(depth[at[k]])) continue;
    const float alpha = 1.0F - w.transmittance[plane + at[k]];
    lacks[k] = alpha < opacity;
    sum += alpha;
    surface += 1.0F;
  }
  for (int step = kLanes / 2; step >= 1; step /= 2) {
    sum += __shfl_xor_sync(0xFFFFFFFFU, sum, step);
    surface += __shfl_xor_sync(0xFFFFFFFFU, surface, step);
  }
  const bool unmodelled = surface > 0.0F && sum < opacity * surface;
  std::uint32_t masked = 0;
#pragma unroll
  for (int k = 0; k < kEach; ++k) {
    const bool by_itself = inside[k] && own != nullptr && own[at[k]] != 0;
    const bool by_model = unmodelled && lacks[k] && !by_itself;
    if (inside[k]) w.mask[plane + at[k]] = by_itself || by_model ? 255 : 0;
    masked += __popc(__ballot_sync(0xFFFFFFFFU, by_model));
  }
  if (lane == 0 && masked > 0) atomicAdd(&w.counts->masked, masked);
}

}  // namespace

void launch_mask_unmodelled(const float* const* depths, const std::uint8_t* const* masks, float opacity,
                            const WorkspaceView& workspace, cudaStream_t stream) {
  const int squares = ((workspace.width + kSide - 1) / kSide) * ((workspace.height + kSide - 1) / kSide);
  if (squares == 0) return;
  constexpr int kSquares = kThreads / kLanes;
  const dim3 blocks(static_cast<unsigned>((squares + kSquares - 1) / kSquares), static_cast<unsigned>(workspace.batch));
  mask_kernel<<<blocks, kThreads, 0, stream>>>(workspace, depths, masks, opacity);
  check(cudaGetLastError(), "masking what nothing models");
}

}  // namespace splatbus::raster::cuda
