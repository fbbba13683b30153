#pragma once

#include "raster/cuda/footprint.cuh"
#include "raster/cuda/kernels.h"

namespace splatbus::raster::cuda {

constexpr unsigned kAllLanes = 0xFFFFFFFFU;
constexpr int kLanes = 32;
/// A block is half a tile. Its warps never wait for one another: each blends one patch, one lane a pixel.
constexpr int kBlendWarps = 4;
constexpr int kBlendThreads = kBlendWarps * kLanes;

/// The patch of a warp and the pixel of a lane.
struct Pixel {
  int tile, patch, view, x0, y0;  // x0, y0: of the patch
  float x, y;                     // pixel centre
  bool inside;
  std::size_t at;  // in a plane of the view
};

__device__ inline Pixel locate(const WorkspaceView& w) {
  Pixel p;
  constexpr int kBlocks = kPatches / kBlendWarps;  // of a tile
  const int tiles = w.tiles_x * w.tiles_y, lane = threadIdx.x & (kLanes - 1);
  p.tile = blockIdx.x / kBlocks;
  p.patch = (blockIdx.x % kBlocks) * kBlendWarps + threadIdx.x / kLanes;
  p.view = p.tile / tiles;
  const int in_view = p.tile - p.view * tiles;
  p.x0 = (in_view % w.tiles_x) * kTileSize + (p.patch % kPatchColumns) * kPatchWidth;
  p.y0 = (in_view / w.tiles_x) * kTileSize + (p.patch / kPatchColumns) * kPatchHeight;
  const int x = p.x0 + lane % kPatchWidth, y = p.y0 + lane / kPatchWidth;
  p.x = x + 0.5F;
  p.y = y + 0.5F;
  p.inside = x < w.width && y < w.height;
  p.at = static_cast<std::size_t>(y) * w.width + x;
  return p;
}

inline int blend_blocks(const WorkspaceView& w) {
  return w.tiles_x * w.tiles_y * w.batch * (kPatches / kBlendWarps);
}

/// The next Gaussians of a patch, in shared memory of its warp.
template <bool kAlbedo>
struct Staged {
  float4 shape[kLanes];  // x, y, log2_alpha, uxx
  float4 rest[kLanes];   // uxy, uyy, red, green
  float2 tail[kLanes];   // blue; the Gaussian's number, as bits
  float4 albedo[kAlbedo ? kLanes : 1];
};

/// Streams the Gaussians that reach a warp's patch out of its tile's list, 32 entries at a time. What the next 32 need
/// is on its way while the last are blended.
template <bool kAlbedo>
class PatchStream {
 public:
  __device__ PatchStream(const DeviceGaussians& gaussians, const WorkspaceView& w, const Pixel& pixel,
                         Staged<kAlbedo>& staged)
      : entries_(w.pair_entries[1]),
        shapes_(w.record_shape + 2 * static_cast<std::size_t>(pixel.view) * w.count),
        tails_(w.record_tail + static_cast<std::size_t>(pixel.view) * w.count),
        albedo_(gaussians.parameters + ParameterLayout::kAlbedo * gaussians.stride),
        stride_(gaussians.stride),
        staged_(staged),
        bit_(1U << (kPatchShift + pixel.patch)) {
    const uint2 range = w.tile_range[pixel.tile];
    at_ = range.x + (threadIdx.x & (kLanes - 1));
    first_ = range.x;
    end_ = range.y;
    entry_ = at_ < end_ ? entries_[at_] : 0;
    fetch();
  }

  [[nodiscard]] __device__ bool empty() const { return first_ >= end_; }
  /// Depth of the last entry that advance() looked at, infinite when that is not known.
  [[nodiscard]] __device__ float depth() const {
    const std::uint32_t last = min(first_, end_);
    if (last == 0) return INFINITY;
    const std::size_t gaussian = entries_[last - 1] & kGaussianMask;
    return isfinite(shapes_[2 * gaussian].z) ? tails_[gaussian].y : INFINITY;
  }

  /// Stages the hits among the next 32 entries and returns how many they are.
  __device__ int advance() {
    const unsigned hits = __ballot_sync(kAllLanes, hit_);
    const unsigned lane = threadIdx.x & (kLanes - 1);
    __syncwarp();
    if (hit_) {
      const int slot = __popc(hits & ((1U << lane) - 1));
      staged_.shape[slot] = shape_;
      staged_.rest[slot] = rest_;
      staged_.tail[slot] = make_float2(blue_, __uint_as_float(gaussian_));
      if constexpr (kAlbedo) staged_.albedo[slot] = make_float4(a_[0], a_[1], a_[2], 0.0F);
    }
    first_ += kLanes;
    fetch();
    __syncwarp();
    return __popc(hits);
  }

 private:
  /// Begins to load the records of the entries in entry_, and the entries after them.
  __device__ void fetch() {
    hit_ = (entry_ & bit_) != 0;
    gaussian_ = entry_ & kGaussianMask;
    if (hit_) {
      shape_ = shapes_[2 * static_cast<std::size_t>(gaussian_)];
      rest_ = shapes_[2 * static_cast<std::size_t>(gaussian_) + 1];
      blue_ = tails_[gaussian_].x;
      if constexpr (kAlbedo) {
        for (int c = 0; c < 3; ++c) a_[c] = albedo_[c * stride_ + gaussian_];
      }
    }
    at_ += kLanes;
    entry_ = at_ < end_ ? entries_[at_] : 0;
  }

  const std::uint32_t* __restrict__ entries_;
  const float4* __restrict__ shapes_;
  const float2* __restrict__ tails_;
  const float* __restrict__ albedo_;
  std::int64_t stride_;
  Staged<kAlbedo>& staged_;
  std::uint32_t bit_, at_, first_, end_, entry_, gaussian_;
  bool hit_;
  float4 shape_, rest_;
  float blue_, a_[kAlbedo ? 3 : 1];
};

__device__ inline float exp2_approximate(float x) {
  float y;
  asm("ex2.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
  return y;
}

/// log2 of a Gaussian's alpha at a pixel; the same operations forward and backward, so that both blend the same.
__device__ inline float log2_alpha_at(const float4& shape, const float4& rest, const Pixel& pixel) {
  const float dx = pixel.x - shape.x, dy = pixel.y - shape.y;
  const float u = __fmaf_rn(shape.w, dx, __fmul_rn(rest.x, dy)), v = __fmul_rn(rest.y, dy);
  return __fmaf_rn(-u, u, __fmaf_rn(-v, v, shape.z));
}

}  // namespace splatbus::raster::cuda
