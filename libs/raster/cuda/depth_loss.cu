#include "raster/cuda/kernels.h"

namespace splatbus::raster::cuda {
namespace {

constexpr int kThreads = 256, kPixelsEach = 4;

__global__ void __launch_bounds__(kThreads)
    depth_loss_kernel(WorkspaceView w, const float* const* targets, ViewMasks masks, float weight) {
  const int view = blockIdx.y;
  const float* target = targets[view];
  const auto pixels = static_cast<std::size_t>(w.width) * w.height;
  const std::uint8_t* mask = masks.of(view, pixels);
  const std::size_t plane = view * pixels;
  float loss = 0.0F;
#pragma unroll
  for (int k = 0; k < kPixelsEach; ++k) {
    const std::size_t at = (static_cast<std::size_t>(blockIdx.x) * kPixelsEach + k) * kThreads + threadIdx.x;
    if (at >= pixels) break;
    const float expected = target != nullptr ? target[at] : 0.0F;
    float slope = 0.0F;
    const bool surface = expected > 0.0F && expected < INFINITY && (mask == nullptr || mask[at] == 0);
    if (surface) {
      const float difference = w.depth[plane + at] - (1.0F - w.transmittance[plane + at]) * expected;
      slope = copysignf(weight, difference);
      loss += fabsf(difference) * weight;
    }
    w.depth_gradient[plane + at] = slope;
    w.alpha_gradient[plane + at] = surface ? -slope * expected : 0.0F;
  }
  if (target == nullptr) return;
  __shared__ float block_loss;
  if (threadIdx.x == 0) block_loss = 0.0F;
  __syncthreads();
  for (int mask = 16; mask >= 1; mask /= 2) loss += __shfl_xor_sync(0xFFFFFFFFU, loss, mask);
  if ((threadIdx.x & 31) == 0) atomicAdd(&block_loss, loss);
  __syncthreads();
  if (threadIdx.x == 0) atomicAdd(w.loss + view, block_loss);
}

}  // namespace

void launch_depth_loss(const float* const* targets, const ViewMasks& masks, const WorkspaceView& workspace,
                       float weight, cudaStream_t stream) {
  const auto pixels = static_cast<std::size_t>(workspace.width) * static_cast<std::size_t>(workspace.height);
  constexpr std::size_t kEach = std::size_t{kThreads} * kPixelsEach;
  const dim3 blocks(static_cast<unsigned>((pixels + kEach - 1) / kEach), static_cast<unsigned>(workspace.batch));
  if (pixels == 0) return;
  depth_loss_kernel<<<blocks, kThreads, 0, stream>>>(workspace, targets, masks, weight);
  check(cudaGetLastError(), "depth loss");
}

}  // namespace splatbus::raster::cuda
