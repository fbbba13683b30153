#include "raster/cuda/blend.cuh"

namespace splatbus::raster::cuda {
namespace {

constexpr unsigned kPatchesOfOne = 4;   // that one is blended for
constexpr float kFixedPoint = 65536.0F;  // a warp's sum of weights stays below 2^21

/// One warp a patch that is blended, as in forward blending and with its tests.
__global__ void __launch_bounds__(kBlendThreads)
    weight_kernel(DeviceGaussians gaussians, WorkspaceView w, PageSums* sums, int pages, unsigned phase) {
  __shared__ Staged<false> all_staged[kBlendWarps];
  Staged<false>& staged = all_staged[threadIdx.x / kLanes];
  const unsigned index = kPatchesOfOne * (blockIdx.x * kBlendWarps + threadIdx.x / kLanes);
  const unsigned patches = static_cast<unsigned>(w.tiles_x * w.tiles_y * w.batch) * kPatches;
  if (index >= patches) return;
  const Pixel pixel = locate_patch(w, index + (index / kPatchesOfOne + phase) % kPatchesOfOne);
  PatchStream<false> stream(gaussians, w, pixel, staged);
  float transmittance = pixel.inside ? 1.0F : 0.0F;
  for (int count = stream.advance(); count > 0; count = stream.advance()) {
    for (int j = 0; j < count; ++j) {
      const float log2_alpha = log2_alpha_at(staged.shape[j], staged.rest[j], pixel);
      const bool taken = log2_alpha >= kLog2AlphaMin && transmittance >= kTransmittanceMin;
      const float alpha = fminf(kAlphaMax, exp2_approximate(log2_alpha));
      const float weight = taken ? __fmul_rn(alpha, transmittance) : 0.0F;
      transmittance = __fsub_rn(transmittance, weight);
      const unsigned sum = __reduce_add_sync(kAllLanes, __float2uint_rn(kFixedPoint * weight));
      if (sum != 0 && threadIdx.x % kLanes == 0) {
        const std::uint32_t page = index_of_row(w.listed, __float_as_uint(staged.tail[j].y)) >> gaussians.page_shift;
        atomicAdd(&sums[static_cast<std::size_t>(pixel.view) * pages + page].weight_px,
                  kPatchesOfOne / kFixedPoint * static_cast<float>(sum));
      }
    }
    if (__all_sync(kAllLanes, transmittance < kTransmittanceMin)) break;
  }
}

}  // namespace

void launch_page_weights(const DeviceGaussians& gaussians, const WorkspaceView& workspace, PageSums* sums, int pages,
                         unsigned phase, cudaStream_t stream) {
  static_assert(kPatches % kPatchesOfOne == 0, "the patches that are blended are of one tile with those they stand for");
  const auto patches = static_cast<unsigned>(workspace.tiles_x * workspace.tiles_y * workspace.batch) * kPatches;
  const unsigned blended = patches / kPatchesOfOne, blocks = (blended + kBlendWarps - 1) / kBlendWarps;
  if (blocks == 0) return;
  weight_kernel<<<blocks, kBlendThreads, 0, stream>>>(gaussians, workspace, sums, pages, phase);
  check(cudaGetLastError(), "weighing pages");
}

}  // namespace splatbus::raster::cuda
