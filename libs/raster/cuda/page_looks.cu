#include "raster/cuda/blend.cuh"
#include "raster/cuda/srgb.cuh"
#include "raster/rasterizer.h"

namespace splatbus::raster::cuda {
namespace {

constexpr float kFixedPoint = 65536.0F;  // the sum of a patch's weights stays below 2^21

/// Of the lane's pixel; below 0 where it does not count.
__device__ float error_at(const LookPictures& pictures, const WorkspaceView& w, const Pixel& pixel) {
  const std::size_t pixels = static_cast<std::size_t>(w.width) * w.height;
  const std::uint8_t* const mask = pictures.masks.of(pixel.view, pixels);
  if (!pixel.inside || (mask != nullptr && mask[pixel.at] != 0)) return -1.0F;
  const float* const rendered = w.color + 3 * pixels * pixel.view + pixel.at;
  const std::uint8_t* const target = pictures.targets[pixel.view] + 4 * pixel.at;
  float sum = 0.0F;
  for (int c = 0; c < 3; ++c) {
    const float shown = display(fminf(fmaxf(rendered[c * pixels], 0.0F), 1.0F), pictures.encode_srgb);
    sum += fabsf(shown - (1.0F / 255.0F) * static_cast<float>(target[c]));
  }
  return sum >= 0.0F ? (1.0F / 3.0F) * sum : -1.0F;
}

/// Adds what each lane has of its page; one lane does it for all that have the same.
__device__ void add_to_pages(PageSums* sums, std::uint32_t page, std::uint32_t weight, float error) {
  const unsigned present = __ballot_sync(kAllLanes, weight != 0);
  if (weight != 0) {
    const unsigned same = __match_any_sync(present, page);
    const std::uint32_t all = __reduce_add_sync(same, weight);
    if (static_cast<int>(threadIdx.x & (kLanes - 1)) == __ffs(static_cast<int>(same)) - 1) {
      const float weight_px = kPatchesALook / kFixedPoint * static_cast<float>(all);
      atomicAdd(&sums[page].weight_px, weight_px);
      atomicAdd(&sums[page].error, error * weight_px);
    }
  }
  __syncwarp();
}

/// One warp a patch that is blended, as in forward blending and with its tests, up to where all else is hidden.
__global__ void __launch_bounds__(kBlendThreads)
    look_kernel(DeviceGaussians gaussians, WorkspaceView w, LookPictures pictures, unsigned turn, PageSums* sums,
                int pages) {
  __shared__ Staged<false> all_staged[kBlendWarps];
  Staged<false>& staged = all_staged[threadIdx.x / kLanes];
  const unsigned group = blockIdx.x * kBlendWarps + threadIdx.x / kLanes;
  if (group * kPatchesALook >= static_cast<unsigned>(w.tiles_x * w.tiles_y * w.batch) * kPatches) return;
  // Neighbours have another one each.
  const Pixel pixel = locate_patch(w, group * kPatchesALook + (group + turn) % kPatchesALook);
  if (pictures.targets[pixel.view] == nullptr) return;
  float error = error_at(pictures, w, pixel);
  float transmittance = error >= 0.0F ? 1.0F : 0.0F;
  const int counted = __popc(__ballot_sync(kAllLanes, error >= 0.0F));
  if (counted == 0) return;
  error = fmaxf(error, 0.0F);
  for (int offset = kLanes / 2; offset > 0; offset /= 2) error += __shfl_xor_sync(kAllLanes, error, offset);
  error /= static_cast<float>(counted);

  PageSums* const of_view = sums + static_cast<std::size_t>(pixel.view) * pages;
  const int lane = threadIdx.x & (kLanes - 1);
  PatchStream<false> stream(gaussians, w, pixel, staged);
  for (int count = stream.advance(); count > 0; count = stream.advance()) {
    std::uint32_t weight_of_lane = 0;  // of the staged Gaussian with its number
    for (int j = 0; j < count; ++j) {
      const float log2_alpha = log2_alpha_at(staged.shape[j], staged.rest[j], pixel);
      const bool taken = log2_alpha >= kLog2AlphaMin && transmittance >= kHiddenTransmittance;
      const float alpha = fminf(kAlphaMax, exp2_approximate(log2_alpha));
      const float weight = taken ? __fmul_rn(alpha, transmittance) : 0.0F;
      transmittance = __fsub_rn(transmittance, weight);
      const std::uint32_t all = __reduce_add_sync(kAllLanes, __float2uint_rn(kFixedPoint * weight));
      if (lane == j) weight_of_lane = all;
    }
    const std::uint32_t row = lane < count ? __float_as_uint(staged.tail[lane].y) : 0;
    const std::uint32_t page = weight_of_lane != 0 ? index_of_row(w.listed, row) >> gaussians.page_shift : 0;
    add_to_pages(of_view, page, weight_of_lane, error);
    if (__all_sync(kAllLanes, transmittance < kHiddenTransmittance)) break;
  }
}

}  // namespace

void launch_page_looks(const DeviceGaussians& gaussians, const WorkspaceView& workspace, const LookPictures& pictures,
                       unsigned turn, PageSums* sums, int pages, cudaStream_t stream) {
  static_assert(kPatches % kPatchesALook == 0, "the patches that one stands for are of its tile");
  const std::size_t bytes =
      sizeof(PageSums) * static_cast<std::size_t>(workspace.batch) * static_cast<std::size_t>(pages);
  check(cudaMemsetAsync(sums, 0, bytes, stream), "clearing the pages' sums");
  const unsigned tiles = static_cast<unsigned>(workspace.tiles_x * workspace.tiles_y * workspace.batch);
  if (tiles == 0) return;
  const unsigned blended = tiles * (kPatches / kPatchesALook), blocks = (blended + kBlendWarps - 1) / kBlendWarps;
  look_kernel<<<blocks, kBlendThreads, 0, stream>>>(gaussians, workspace, pictures, turn, sums, pages);
  check(cudaGetLastError(), "looking at pages");
}

}  // namespace splatbus::raster::cuda
