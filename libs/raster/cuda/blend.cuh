#pragma once

#include <type_traits>

#include "raster/cuda/footprint.cuh"
#include "raster/cuda/kernels.h"
#include "raster/cuda/range_lanes.cuh"

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

/// Of patch `index` of the batch.
__device__ inline Pixel locate_patch(const WorkspaceView& w, unsigned index) {
  Pixel p;
  const int tiles = w.tiles_x * w.tiles_y, lane = threadIdx.x & (kLanes - 1);
  p.tile = static_cast<int>(index / kPatches);
  p.patch = static_cast<int>(index % kPatches);
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

/// Of the patch that this warp blends when each has one.
__device__ inline Pixel locate(const WorkspaceView& w, unsigned first_block = 0) {
  return locate_patch(w, (first_block + blockIdx.x) * kBlendWarps + threadIdx.x / kLanes);
}

inline int blend_blocks(const WorkspaceView& w) {
  return w.tiles_x * w.tiles_y * w.batch * (kPatches / kBlendWarps);
}

/// Calls `run` with whether there is an albedo plane, and whether there is something else, as compile-time constants.
template <class Run>
void with_planes(bool albedo, bool depth, Run run) {
  if (albedo && depth) return run(std::true_type{}, std::true_type{});
  if (albedo) return run(std::true_type{}, std::false_type{});
  if (depth) return run(std::false_type{}, std::true_type{});
  run(std::false_type{}, std::false_type{});
}

/// The next Gaussians of a patch, in shared memory of its warp; with kExtra their albedo and depth, with kPositions
/// also where their entries are.
template <bool kExtra, bool kPositions = false>
struct Staged {
  float4 shape[kLanes];               // x, y, log2_alpha, uxx
  float4 rest[kLanes];                // uxy, uyy, red, green
  float2 tail[kLanes];                // blue; the row, as bits
  float4 extra[kExtra ? kLanes : 1];  // albedo, depth
  std::uint32_t queue[256];           // a ring of rows that reach the patch
  std::uint32_t positions[kPositions ? 256 : 1];
};

/// Streams the Gaussians that reach a warp's patch out of its tile's list. Entries are looked at 128 at a time,
/// projected Gaussians fetched 32 at a time; both are on their way while what came before is blended.
template <bool kAlbedo, bool kDepth = false, bool kPositions = false>
class PatchStream {
 public:
  /// From entry `begin` on, where that lies behind the first one of the tile.
  __device__ PatchStream(const DeviceGaussians& gaussians, const WorkspaceView& w, const Pixel& pixel,
                         Staged<kAlbedo || kDepth, kPositions>& staged, std::uint32_t begin = 0)
      : entries_(reinterpret_cast<const uint4*>(w.flatten_ids[1])),
        shapes_(w.projected_shape + 2 * static_cast<std::size_t>(pixel.view) * w.rows),
        tails_(w.projected_tail + static_cast<std::size_t>(pixel.view) * w.rows),
        parameters_(parameters_of(gaussians)),
        listed_(w.listed),
        staged_(staged),
        bit_(1U << (kPatchShift + pixel.patch)),
        lane_(threadIdx.x & (kLanes - 1)) {
    const uint2 range = w.tile_offsets[pixel.tile];
    first_ = max(range.x, begin);
    end_ = range.y;
    // Vectors of four entries are aligned, so the first may hold some of the tile before.
    at_ = first_ / 4 * 4;
    load();
    fetch();
  }

  /// Stages the next Gaussians, at most 32, and returns how many they are: 0 at the end.
  __device__ int advance() {
    const int count = fetched_;
    position_ = fetched_position_;
    __syncwarp();
    if (lane_ < count) {
      staged_.shape[lane_] = shape_;
      staged_.rest[lane_] = rest_;
      staged_.tail[lane_] = make_float2(blue_, __uint_as_float(row_));
      if constexpr (kAlbedo && kDepth) staged_.extra[lane_] = make_float4(a_[0], a_[1], a_[2], z_[0]);
      if constexpr (kAlbedo && !kDepth) staged_.extra[lane_] = make_float4(a_[0], a_[1], a_[2], 0.0F);
      if constexpr (!kAlbedo && kDepth) staged_.extra[lane_].w = z_[0];
    }
    fetch();
    __syncwarp();
    return count;
  }

  /// Where the entry of the first staged Gaussian is.
  [[nodiscard]] __device__ std::uint32_t position() const { return position_; }
  /// Where that of the first one is that is not staged yet; behind all, where there is none.
  [[nodiscard]] __device__ std::uint32_t next_position() const { return fetched_ > 0 ? fetched_position_ : end_; }

 private:
  __device__ void load() {
    const std::uint32_t at = at_ + 4 * lane_;
    next_ = at < end_ ? entries_[at / 4] : make_uint4(0, 0, 0, 0);
  }

  /// Queues the hits among the next 128 entries, in their order.
  __device__ void scan() {
    const std::uint32_t at = at_ + 4 * lane_;
    const std::uint32_t entries[4] = {next_.x, next_.y, next_.z, next_.w};
    at_ += 4 * kLanes;
    load();
    bool hit[4];
    std::uint32_t slot = head_ + queued_;
    const unsigned before = (1U << lane_) - 1;
#pragma unroll
    for (int k = 0; k < 4; ++k) {
      hit[k] = (entries[k] & bit_) != 0 && at + k >= first_ && at + k < end_;
      const unsigned hits = __ballot_sync(kAllLanes, hit[k]);
      slot += __popc(hits & before);
      queued_ += __popc(hits);
    }
#pragma unroll
    for (int k = 0; k < 4; ++k) {
      if (!hit[k]) continue;
      if constexpr (kPositions) staged_.positions[slot % 256] = at + k;
      staged_.queue[slot++ % 256] = entries[k] & kRowMask;
    }
  }

  /// Begins to load the next 32 projected Gaussians.
  __device__ void fetch() {
    while (queued_ < kLanes && at_ < end_) scan();
    __syncwarp();
    fetched_ = min(queued_, kLanes);
    if constexpr (kPositions) fetched_position_ = staged_.positions[head_ % 256];
    if (lane_ < fetched_) {
      row_ = staged_.queue[(head_ + lane_) % 256];
      shape_ = shapes_[2 * static_cast<std::size_t>(row_)];
      rest_ = shapes_[2 * static_cast<std::size_t>(row_) + 1];
      if constexpr (kDepth) {
        const float2 tail = tails_[row_];
        blue_ = tail.x;
        z_[0] = tail.y;
      } else {
        blue_ = tails_[row_].x;
      }
      if constexpr (kAlbedo) {
        // Of those that are not to be seen it may not be finite.
        const bool seen = shape_.z > -INFINITY;
        const auto index = static_cast<int>(index_of_row(listed_, row_));
        for (int c = 0; c < 3; ++c) a_[c] = seen ? parameters_(ParameterLayout::kAlbedo + c, index) : 0.0F;
      }
    }
    head_ += fetched_;
    queued_ -= fetched_;
  }

  const uint4* __restrict__ entries_;
  const float4* __restrict__ shapes_;
  const float2* __restrict__ tails_;
  Channels<float> parameters_;
  const ListedRange* listed_;
  Staged<kAlbedo || kDepth, kPositions>& staged_;
  std::uint32_t bit_, at_, first_, end_, row_, head_ = 0, position_ = 0, fetched_position_ = 0;
  int lane_, queued_ = 0, fetched_ = 0;
  uint4 next_;
  float4 shape_, rest_;
  float blue_, a_[kAlbedo ? 3 : 1], z_[1];
};

__device__ inline float exp2_approximate(float x) {
  float y;
  asm("ex2.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
  return y;
}

/// Of a frozen range, as its shape says.
__device__ inline bool is_resting(const float4& shape) {
  return signbit(shape.w);
}

/// Ranges or intersections of the step are missing: it is to change nothing.
__device__ inline bool is_incomplete(const WorkspaceView& w) {
  return w.counts->isects > w.isect_capacity || w.counts->seen > w.list_capacity;
}

/// log2 of a Gaussian's alpha at a pixel; the same operations forward and backward, so that both blend the same.
__device__ inline float log2_alpha_at(const float4& shape, const float4& rest, const Pixel& pixel) {
  const float dx = pixel.x - shape.x, dy = pixel.y - shape.y;
  const float u = __fmaf_rn(shape.w, dx, __fmul_rn(rest.x, dy)), v = __fmul_rn(rest.y, dy);
  return __fmaf_rn(-u, u, __fmaf_rn(-v, v, shape.z));
}

}  // namespace splatbus::raster::cuda
