#include "capture-bridge/cuda/kernels.h"
#include "capture-bridge/cuda/launch.h"
#include "capture-bridge/surface_math.h"

namespace splatbus::capture_bridge::cuda {
namespace {

/// One thread a pixel; a row of blocks a view.
__global__ void check_kernel(RoundPixels round, RoundTally* tally) {
  __shared__ std::uint32_t faults[kFaults];
  if (threadIdx.x < kFaults) faults[threadIdx.x] = 0;
  __syncthreads();
  const std::uint32_t in_view = item_of_thread();
  if (in_view < round.view_pixels) {
    const PixelView& view = round.views[blockIdx.y];
    const SurfacePixel pixel = check_pixel(view, in_view % view.width, in_view / view.width);
    const std::uint32_t i = view.first_pixel + in_view;
    round.depth_m[i] = pixel.depth_m;
    round.cosine[i] = pixel.cosine;
    round.object_id[i] = pixel.object_id;
    if (pixel.fault != PixelFault::None) atomicAdd(&faults[static_cast<int>(pixel.fault)], 1U);
  }
  __syncthreads();
  if (threadIdx.x < kFaults && faults[threadIdx.x] > 0) {
    atomicAdd(&tally->faults[blockIdx.y][threadIdx.x], faults[threadIdx.x]);
  }
}

__global__ void measure_kernel(RoundPixels round, float min_cosine) {
  const std::uint32_t in_view = item_of_thread();
  if (in_view >= round.view_pixels) return;
  const PixelView& view = round.views[blockIdx.y];
  const std::uint32_t i = view.first_pixel + in_view;
  Texel texel;
  if (round.depth_m[i] != 0 && !(round.cosine[i] < min_cosine)) {
    const CheckedPixels checked{round.depth_m + view.first_pixel, round.object_id + view.first_pixel};
    texel = measured_texel(view, checked, in_view % view.width, in_view / view.width);
  }
  round.texels[i] = texel;
}

__global__ void rank_kernel(RoundPixels round, CullOptions options, RoundTally* tally) {
  __shared__ std::uint32_t of_rank[256];
  static_assert(kThreads == 256, "a thread clears one rank");
  of_rank[threadIdx.x] = 0;
  __syncthreads();
  const std::uint32_t in_view = item_of_thread();
  if (in_view < round.view_pixels) {
    const std::uint32_t own = blockIdx.y;
    const std::uint32_t pixel = round.views[own].first_pixel + in_view;
    const Texel point = round.texels[pixel];
    SurfaceRank rank;
    if (point.footprint_m != 0) {
      const Sight sight(round.views, round.texels, round.movement, options);
      const auto sees = [&](std::uint32_t other, float& found) { return sight.sees(other, own, point, found); };
      rank = rank_among(round.view_count, own, sight.own_quality(own, point), options.similar, sees);
    }
    round.ranks[pixel] = rank;
    atomicAdd(&of_rank[rank.rank], 1U);
  }
  __syncthreads();
  if (of_rank[threadIdx.x] > 0) atomicAdd(&tally->of_rank[threadIdx.x], of_rank[threadIdx.x]);
}

}  // namespace

void launch_surface(const RoundPixels& round, float min_cosine, RoundTally* tally, cudaStream_t stream) {
  const dim3 blocks(blocks_for(round.view_pixels), round.view_count);
  check_kernel<<<blocks, kThreads, 0, stream>>>(round, tally);
  check_launch("checking input pixels");
  measure_kernel<<<blocks, kThreads, 0, stream>>>(round, min_cosine);
  check_launch("measuring input pixels");
}

void launch_ranks(const RoundPixels& round, const CullOptions& options, RoundTally* tally, cudaStream_t stream) {
  rank_kernel<<<dim3(blocks_for(round.view_pixels), round.view_count), kThreads, 0, stream>>>(round, options, tally);
  check_launch("ranking samples across cameras");
}

}  // namespace splatbus::capture_bridge::cuda
