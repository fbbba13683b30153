#include "raster/cuda/blend.cuh"

namespace splatbus::raster::cuda {
namespace {

/// One warp a patch, as in forward blending and with its tests.
__global__ void __launch_bounds__(kBlendThreads)
    contribution_kernel(DeviceGaussians gaussians, WorkspaceView w, int view, float* contribution) {
  __shared__ Staged<false> all_staged[kBlendWarps];
  Staged<false>& staged = all_staged[threadIdx.x / kLanes];
  const Pixel pixel = locate(w, static_cast<unsigned>(view * w.tiles_x * w.tiles_y * (kPatches / kBlendWarps)));
  PatchStream<false> stream(gaussians, w, pixel, staged);
  float transmittance = pixel.inside ? 1.0F : 0.0F;
  for (int count = stream.advance(); count > 0; count = stream.advance()) {
    for (int j = 0; j < count; ++j) {
      const float log2_alpha = log2_alpha_at(staged.shape[j], staged.rest[j], pixel);
      const bool taken = log2_alpha >= kLog2AlphaMin && transmittance >= kTransmittanceMin;
      const float alpha = fminf(kAlphaMax, exp2_approximate(log2_alpha));
      const float weight = taken ? __fmul_rn(alpha, transmittance) : 0.0F;
      transmittance = __fsub_rn(transmittance, weight);
      // Floats that are not negative order as their bits do.
      const unsigned largest = __reduce_max_sync(kAllLanes, __float_as_uint(weight));
      if (largest != 0 && threadIdx.x % kLanes == 0) {
        const std::uint32_t index = index_of_row(w.listed, __float_as_uint(staged.tail[j].y));
        atomicMax(reinterpret_cast<unsigned*>(contribution) + index, largest);
      }
    }
    if (__all_sync(kAllLanes, transmittance < kTransmittanceMin)) break;
  }
}

}  // namespace

void launch_contribution(const DeviceGaussians& gaussians, const WorkspaceView& workspace, int view,
                         float* contribution, cudaStream_t stream) {
  const int blocks = blend_blocks(workspace) / workspace.batch;
  if (blocks == 0) return;
  contribution_kernel<<<blocks, kBlendThreads, 0, stream>>>(gaussians, workspace, view, contribution);
  check(cudaGetLastError(), "contributions");
}

}  // namespace splatbus::raster::cuda
