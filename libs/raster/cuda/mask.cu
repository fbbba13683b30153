#include "raster/cuda/blend.cuh"
#include "raster/cuda/kernels.h"
#include "raster/unmodelled.h"

namespace splatbus::raster::cuda {
namespace {

constexpr int kThreads = 256, kSide = kUnmodelledSide, kEach = kSide * kSide / kLanes;

/// What Gaussians nearer than the far field let through at a pixel; below 0.01 it may be more than it would come to. A
/// product does not ask for an order, so that each lane takes entries of its own. All lanes get the result.
__device__ float near_transmittance(const WorkspaceView& w, int view, int column, int row) {
  constexpr float kOpaque = 0.01F;
  const int lane = threadIdx.x % kLanes;
  const int tile = view * w.tiles_x * w.tiles_y + row / kTileSize * w.tiles_x + column / kTileSize;
  const int patch = row % kTileSize / kPatchHeight * kPatchColumns + column % kTileSize / kPatchWidth;
  const DeviceView camera = w.views[view];
  const uint2 entries = w.tile_offsets[tile];
  Pixel pixel;
  pixel.x = static_cast<float>(column) + 0.5F;
  pixel.y = static_cast<float>(row) + 0.5F;
  float transmittance = 1.0F;
  for (std::uint32_t begin = entries.x; begin < entries.y && transmittance > kOpaque; begin += kLanes) {
    const std::uint32_t entry = begin + lane < entries.y ? w.flatten_ids[1][begin + lane] : 0;
    float passes = 1.0F;
    if ((entry & 1U << (kPatchShift + patch)) != 0) {
      const std::size_t at = static_cast<std::size_t>(view) * w.rows + (entry & kRowMask);
      const float4 shape = w.projected_shape[2 * at], rest = w.projected_shape[2 * at + 1];
      const float log2_alpha = log2_alpha_at(shape, rest, pixel);
      const float tan_x = (shape.x - camera.cx) / camera.fx, tan_y = (shape.y - camera.cy) / camera.fy;
      const float distance_m = w.projected_tail[at].y * sqrtf(1.0F + tan_x * tan_x + tan_y * tan_y);
      if (log2_alpha >= kLog2AlphaMin && distance_m < kNearerThanFarField_m) {
        passes = 1.0F - fminf(exp2_approximate(log2_alpha), kAlphaMax);
      }
    }
    for (int step = kLanes / 2; step >= 1; step /= 2) passes *= __shfl_xor_sync(kAllLanes, passes, step);
    transmittance *= passes;
  }
  return transmittance;
}

/// Whether what is near does not hide the far field at the samples of a square that show a surface. One warp.
__device__ bool lacks_near(const WorkspaceView& w, const float* depth, int view, int x0, int y0, float opacity) {
  float sum = 0.0F, samples = 0.0F;
  for (int k = 0; k < kUnmodelledSamples; ++k) {
    const int column = x0 + unmodelled_sample(k), row = y0 + unmodelled_sample(k);
    if (column >= w.width || row >= w.height) continue;
    if (!shows_surface(depth[static_cast<std::size_t>(row) * w.width + column])) continue;
    sum += 1.0F - near_transmittance(w, view, column, row);
    samples += 1.0F;
  }
  return samples > 0.0F && sum < opacity * samples;
}

/// One warp a square.
template <bool kFarField>
__global__ void __launch_bounds__(kThreads)
    mask_kernel(WorkspaceView w, const float* const* depths, const std::uint8_t* const* masks, float opacity) {
  const int lane = threadIdx.x % kLanes, view = blockIdx.y;
  const int columns = (w.width + kSide - 1) / kSide, rows = (w.height + kSide - 1) / kSide;
  const int square = static_cast<int>(blockIdx.x * (kThreads / kLanes) + threadIdx.x / kLanes);
  if (square >= columns * rows) return;
  const std::size_t plane = static_cast<std::size_t>(view) * w.width * w.height;
  const float* const depth = depths[view];
  const std::uint8_t* const own = masks == nullptr ? nullptr : masks[view];
  const int corner_x = square % columns * kSide, corner_y = square / columns * kSide;
  const int x = corner_x + lane % kSide, y0 = corner_y + lane / kSide;
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
    sum += __shfl_xor_sync(kAllLanes, sum, step);
    surface += __shfl_xor_sync(kAllLanes, surface, step);
  }
  bool unmodelled = surface > 0.0F && sum < opacity * surface;
  if (kFarField && w.counts->far_field > 0 && surface > 0.0F &&
      lacks_near(w, depth, view, corner_x, corner_y, opacity)) {
    unmodelled = true;
#pragma unroll
    for (int k = 0; k < kEach; ++k) lacks[k] = inside[k] && shows_surface(depth[at[k]]);
  }
  std::uint32_t masked = 0;
#pragma unroll
  for (int k = 0; k < kEach; ++k) {
    const bool by_itself = inside[k] && own != nullptr && own[at[k]] != 0;
    const bool by_model = unmodelled && lacks[k] && !by_itself;
    if (inside[k]) w.mask[plane + at[k]] = by_itself || by_model ? 255 : 0;
    masked += __popc(__ballot_sync(kAllLanes, by_model));
  }
  if (lane == 0 && masked > 0) atomicAdd(&w.counts->masked, masked);
}

}  // namespace

void launch_mask_unmodelled(const float* const* depths, const std::uint8_t* const* masks, float opacity, bool far_field,
                            const WorkspaceView& workspace, cudaStream_t stream) {
  const int squares = ((workspace.width + kSide - 1) / kSide) * ((workspace.height + kSide - 1) / kSide);
  if (squares == 0) return;
  constexpr int kSquares = kThreads / kLanes;
  const dim3 blocks(static_cast<unsigned>((squares + kSquares - 1) / kSquares), static_cast<unsigned>(workspace.batch));
  const auto kernel = far_field ? mask_kernel<true> : mask_kernel<false>;
  kernel<<<blocks, kThreads, 0, stream>>>(workspace, depths, masks, opacity);
  check(cudaGetLastError(), "masking what nothing models");
}

}  // namespace splatbus::raster::cuda
