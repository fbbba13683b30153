#include "raster/cuda/blend.cuh"

namespace splatbus::raster::cuda {
namespace {

/// Notes where a patch's next segment begins, and the pixels' state before it, and returns which one it is.
template <bool kExtra>
__device__ std::uint32_t begin_segment(const WorkspaceView& w, const Pixel& pixel, std::uint32_t position, float4 color,
                                       float4 extra) {
  const int lane = threadIdx.x & (kLanes - 1);
  std::uint32_t slot = 0;
  if (lane == 0) slot = atomicAdd(&w.counts->segments, 1U);
  slot = __shfl_sync(kAllLanes, slot, 0);
  if (slot >= w.segment_capacity) return slot;
  if (lane == 0) w.segments[slot] = make_uint2(static_cast<unsigned>(kPatches * pixel.tile + pixel.patch), position);
  w.segment_color[kLanes * static_cast<std::size_t>(slot) + lane] = color;
  if constexpr (kExtra) w.segment_extra[kLanes * static_cast<std::size_t>(slot) + lane] = extra;
  return slot;
}

/// `segment`: of the patches' first ones and those behind them.
__device__ void end_segment(const WorkspaceView& w, std::uint32_t segment, bool trains) {
  const auto patches = static_cast<std::uint32_t>(w.tiles_x * w.tiles_y * w.batch * kPatches);
  if (w.segment_trains == nullptr || (threadIdx.x & (kLanes - 1)) != 0) return;
  if (segment < patches + w.segment_capacity) w.segment_trains[segment] = trains ? 1 : 0;
}

template <bool kAlbedo, bool kDepth, bool kSegments>
__global__ void __launch_bounds__(kBlendThreads, 8) blend_forward_kernel(DeviceGaussians gaussians, WorkspaceView w) {
  constexpr bool kExtra = kAlbedo || kDepth;
  __shared__ Staged<kExtra, kSegments> all_staged[kBlendWarps];
  Staged<kExtra, kSegments>& staged = all_staged[threadIdx.x / kLanes];
  const Pixel pixel = locate(w);
  PatchStream<kAlbedo, kDepth, kSegments> stream(gaussians, w, pixel, staged);
  int group = 0;
  const auto patch = static_cast<std::uint32_t>(kPatches * pixel.tile + pixel.patch);
  std::uint32_t segment = patch;
  bool trains = false;
  float transmittance = pixel.inside ? 1.0F : 0.0F, red = 0.0F, green = 0.0F, blue = 0.0F;
  float albedo[3] = {0.0F, 0.0F, 0.0F}, depth = 0.0F;
  for (int count = stream.advance(); count > 0; count = stream.advance()) {
    if constexpr (kSegments) {
      if (group > 0 && group % kSegmentGroups == 0) {
        end_segment(w, segment, trains);
        trains = false;
        segment = w.tiles_x * w.tiles_y * w.batch * kPatches +
                  begin_segment<kExtra>(w, pixel, stream.position(), make_float4(transmittance, red, green, blue),
                                        make_float4(albedo[0], albedo[1], albedo[2], depth));
      }
      ++group;
      const int lane = threadIdx.x & (kLanes - 1);
      trains = __any_sync(kAllLanes, lane < count && !is_resting(staged.shape[lane])) || trains;
    }
#pragma unroll 4
    for (int j = 0; j < count; ++j) {
      const float4 rest = staged.rest[j];
      const float log2_alpha = log2_alpha_at(staged.shape[j], rest, pixel);
      const bool taken = log2_alpha >= kLog2AlphaMin && transmittance >= kTransmittanceMin;
      const float alpha = fminf(kAlphaMax, exp2_approximate(log2_alpha));
      const float weight = taken ? __fmul_rn(alpha, transmittance) : 0.0F;
      transmittance = __fsub_rn(transmittance, weight);
      red += weight * rest.z;
      green += weight * rest.w;
      blue += weight * staged.tail[j].x;
      if constexpr (kAlbedo) {
        const float4 a = staged.extra[j];
        albedo[0] += weight * a.x;
        albedo[1] += weight * a.y;
        albedo[2] += weight * a.z;
      }
      if constexpr (kDepth) depth += weight * staged.extra[j].w;
    }
    if (__all_sync(kAllLanes, transmittance < kTransmittanceMin)) break;
  }
  if constexpr (kSegments) {
    end_segment(w, segment, trains);
    if (w.patch_end != nullptr && (threadIdx.x & (kLanes - 1)) == 0) w.patch_end[patch] = stream.next_position();
  }
  if (!pixel.inside) return;
  const std::size_t pixels = static_cast<std::size_t>(w.width) * w.height;
  const float* background = w.views[pixel.view].background;
  float* color = w.color + 3 * pixels * pixel.view + pixel.at;
  color[0] = red + transmittance * background[0];
  color[pixels] = green + transmittance * background[1];
  color[2 * pixels] = blue + transmittance * background[2];
  w.transmittance[pixels * pixel.view + pixel.at] = transmittance;
  if constexpr (kAlbedo) {
    float* out = w.albedo + 3 * pixels * pixel.view + pixel.at;
    for (int c = 0; c < 3; ++c) out[c * pixels] = albedo[c];
  }
  if constexpr (kDepth) w.depth[pixels * pixel.view + pixel.at] = depth;
}

}  // namespace

void launch_blend_forward(const DeviceGaussians& gaussians, const WorkspaceView& workspace, cudaStream_t stream) {
  const int blocks = blend_blocks(workspace);
  if (blocks == 0) return;
  const auto launch = [&](auto segments) {
    with_planes(workspace.albedo != nullptr, workspace.depth != nullptr, [&](auto albedo, auto depth) {
      blend_forward_kernel<albedo(), depth(), segments()><<<blocks, kBlendThreads, 0, stream>>>(gaussians, workspace);
    });
  };
  if (workspace.segments != nullptr) {
    launch(std::true_type{});
  } else {
    launch(std::false_type{});
  }
  check(cudaGetLastError(), "forward blending");
}

}  // namespace splatbus::raster::cuda
