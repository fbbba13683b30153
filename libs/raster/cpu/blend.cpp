#include <algorithm>
#include <array>
#include <bit>
#include <limits>

#include "raster/cpu/kernels.h"

// Highway needs this order.
// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/blend.cpp"
#include "hwy/foreach_target.h"
#include "raster/cpu/alpha-inl.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace splatbus::raster::cpu::HWY_NAMESPACE {

/// Blended planes of a Splat: red green blue | depth | albedo.
template <int kPlanes, bool kKeep>
struct TileState {
  static constexpr std::uint32_t kSide = tile_side(kKeep), kPixels = kSide * kSide;
  alignas(64) float transmittance[kPixels];
  alignas(64) std::int32_t last[kKeep ? kPixels : 1];
  alignas(64) float planes[kPlanes][kPixels];
};

/// Entries of a tile's list looked at at once: their Splats stay in the first level of cache while the tile's blocks
/// take them in turn.
template <bool kKeep>
constexpr std::uint32_t kChunk = kKeep ? 64 : 128;

/// A chunk's entries, Gaussians and blocks apart; what lies behind its end reaches no block.
template <bool kKeep>
struct Chunk {
  HWY_ALIGN std::uint32_t gaussian[kChunk<kKeep> + hn::MaxLanes(U())];
  HWY_ALIGN std::uint32_t blocks[kChunk<kKeep> + hn::MaxLanes(U())];
  std::uint32_t count;

  HWY_INLINE void Load(const Frame& frame, std::uint32_t begin, std::uint32_t n) {
    const U u;
    const auto lanes = static_cast<std::uint32_t>(hn::Lanes(u));
    count = n;
    std::uint32_t k = 0;
    for (; k + lanes <= n; k += lanes) {
      if constexpr (kKeep) {
        const auto packed = hn::LoadU(u, frame.entries.data() + begin + k);
        hn::Store(hn::And(packed, hn::Set(u, kGaussianMask)), u, gaussian + k);
        hn::Store(hn::ShiftRight<kBlockShift>(packed), u, blocks + k);
      } else {
        hn::Vec<U> of_gaussian, of_blocks;
        hn::LoadInterleaved2(u, &frame.wide_entries[begin + k].gaussian, of_gaussian, of_blocks);
        hn::Store(of_gaussian, u, gaussian + k);
        hn::Store(of_blocks, u, blocks + k);
      }
    }
    hn::Store(hn::Zero(u), u, blocks + k);
    for (; k < n; ++k) {
      if constexpr (kKeep) {
        gaussian[k] = frame.entries[begin + k] & kGaussianMask;
        blocks[k] = frame.entries[begin + k] >> kBlockShift;
      } else {
        gaussian[k] = frame.wide_entries[begin + k].gaussian;
        blocks[k] = frame.wide_entries[begin + k].blocks;
      }
    }
  }
};

/// The entries of a chunk that reach one block, closed up.
template <bool kKeep>
struct BlockList {
  std::uint32_t count;
  HWY_ALIGN std::uint32_t gaussian[kChunk<kKeep> + hn::MaxLanes(U())];
  HWY_ALIGN std::uint32_t index[kChunk<kKeep> + hn::MaxLanes(U())];  ///< in the chunk
};

template <bool kKeep>
HWY_INLINE void CloseUp(const Chunk<kKeep>& chunk, std::uint32_t block, BlockList<kKeep>& out) {
  const U u;
  const auto bit = hn::Set(u, 1U << block);
  out.count = 0;
  for (std::uint32_t k = 0; k < chunk.count; k += static_cast<std::uint32_t>(hn::Lanes(u))) {
    const auto reached = hn::TestBit(hn::Load(u, chunk.blocks + k), bit);
    hn::StoreU(hn::Compress(hn::Load(u, chunk.gaussian + k), reached), u, out.gaussian + out.count);
    if constexpr (kKeep) hn::StoreU(hn::Compress(hn::Iota(u, k), reached), u, out.index + out.count);
    out.count += static_cast<std::uint32_t>(hn::CountTrue(u, reached));
  }
}

/// Blends the Gaussians of a list into one vector of pixels, whose state stays in registers. Returns how many entries
/// of the chunk were needed until no pixel took anything any more (0 where that is not kept), or `unfinished`.
template <int kPlanes, bool kKeep>
HWY_INLINE std::uint32_t BlendPixels(const Frame& frame, const BlockList<kKeep>& list, std::uint32_t first_index,
                                     std::uint32_t pixel, const PixelCentres<tile_side(kKeep)>& centres,
                                     std::uint32_t unfinished, TileState<kPlanes, kKeep>& tile) {
  const F f;
  const I d;
  const V transmittance_min = Splat1(kTransmittanceMin), log2_alpha_min = Splat1(kLog2AlphaMin);
  const V x = hn::Load(f, centres.x + pixel), y = hn::Load(f, centres.y + pixel);
  V transmittance = hn::Load(f, tile.transmittance + pixel);
  auto last = hn::Zero(d);
  if constexpr (kKeep) last = hn::Load(d, tile.last + pixel);
  V planes[kPlanes];
  for (int c = 0; c < kPlanes; ++c) planes[c] = hn::Load(f, tile.planes[c] + pixel);
  M alive = hn::Ge(transmittance, transmittance_min);
  std::uint32_t needed = hn::AllFalse(f, alive) ? 0 : unfinished;
  for (std::uint32_t k = 0; k < list.count && needed != 0; ++k) {
    const Splat& splat = frame.splats[list.gaussian[k]];
    const Footprint footprint = Evaluate(splat, x, y);
    const M taken = hn::And(hn::Ge(footprint.log2_alpha, log2_alpha_min), alive);
    const V alpha = hn::Min(Exp2(footprint.log2_alpha), Splat1(kAlphaMax));
    const V weight = hn::IfThenElseZero(taken, hn::Mul(alpha, transmittance));
    transmittance = hn::Sub(transmittance, weight);
    const float* colour = &splat.red;
    for (int c = 0; c < kPlanes; ++c) planes[c] = hn::MulAdd(Splat1(colour[c]), weight, planes[c]);
    const M still_alive = hn::Ge(transmittance, transmittance_min);
    if constexpr (kKeep) {
      const auto index = hn::Set(d, static_cast<std::int32_t>(first_index + list.index[k]));
      last = hn::IfThenElse(hn::RebindMask(d, hn::AndNot(still_alive, alive)), index, last);
    }
    alive = still_alive;
    if (HWY_UNLIKELY(hn::AllFalse(f, alive))) {
      needed = kKeep ? list.index[k] + 1 : 0;
      break;
    }
  }
  hn::Store(transmittance, f, tile.transmittance + pixel);
  if constexpr (kKeep) hn::Store(last, d, tile.last + pixel);
  for (int c = 0; c < kPlanes; ++c) hn::Store(planes[c], f, tile.planes[c] + pixel);
  return needed;
}

/// The part of a tile that lies in the image.
struct TileArea {
  std::uint32_t x, y, width, height;
};
inline TileArea AreaOf(const Frame& frame, std::uint32_t tile, std::uint32_t side) {
  const std::uint32_t x = tile % frame.tiles_x * side, y = tile / frame.tiles_x * side;
  return {x, y, std::min(side, frame.camera.width - x), std::min(side, frame.camera.height - y)};
}

template <std::uint32_t kSide>
inline void WritePlane(const TileArea& area, const float* values, float* plane, std::size_t row_stride) {
  if (area.width == kSide && area.height == kSide) {
    for (std::uint32_t i = 0; i < kSide * kSide; i += kBlockSide) {
      std::copy_n(values + i, kBlockSide,
                  plane + (area.y + block_order_y<kSide>(i)) * row_stride + area.x + block_order_x<kSide>(i));
    }
    return;
  }
  for (std::uint32_t i = 0; i < kSide * kSide; ++i) {
    const std::uint32_t x = block_order_x<kSide>(i), y = block_order_y<kSide>(i);
    if (x < area.width && y < area.height) plane[(area.y + y) * row_stride + area.x + x] = values[i];
  }
}

/// Splats of a tile lie apart in memory.
template <bool kKeep>
HWY_INLINE void PrefetchSplats(const Frame& frame, std::uint32_t begin, std::uint32_t end) {
  for (std::uint32_t k = begin; k < end; ++k) {
    if constexpr (kKeep) {
      hwy::Prefetch(&frame.splats[frame.entries[k] & kGaussianMask]);
    } else {
      hwy::Prefetch(&frame.splats[frame.wide_entries[k].gaussian]);
    }
  }
}

template <int kPlanes, bool kKeep>
void BlendTilePlanes(Frame& frame, std::uint32_t tile_index, Render& out) {
  constexpr std::uint32_t kSide = tile_side(kKeep), kPixels = kSide * kSide, kBlocks = kPixels / kBlockPixels;
  constexpr std::uint32_t kAtOnce = kChunk<kKeep>;
  const TileArea area = AreaOf(frame, tile_index, kSide);
  TileState<kPlanes, kKeep> tile{};
  std::uint32_t live = 0;
  for (std::uint32_t i = 0; i < kPixels; ++i) {
    const bool inside = block_order_x<kSide>(i) < area.width && block_order_y<kSide>(i) < area.height;
    tile.transmittance[i] = inside ? 1.0F : 0.0F;
    if constexpr (kKeep) tile.last[i] = inside ? std::numeric_limits<std::int32_t>::max() : -1;
    if (inside) live |= 1U << (i / kBlockPixels);
  }

  const std::uint32_t begin = frame.tile_begin[tile_index], end = frame.tile_begin[tile_index + 1];
  if (tile_index + 1 < frame.tile_count()) {
    PrefetchSplats<kKeep>(frame, end, std::min(end + kAtOnce / 2, frame.tile_begin[tile_index + 2]));
  }
  std::array<std::uint32_t, kBlocks> finished_after;
  for (std::uint32_t b = 0; b < kBlocks; ++b) finished_after[b] = (live >> b & 1U) != 0 ? end - begin : 0;
  const PixelCentres<kSide> centres(area.x, area.y);
  Chunk<kKeep> chunk;
  BlockList<kKeep> list;
  for (std::uint32_t first = begin; first < end && live != 0; first += kAtOnce) {
    const std::uint32_t count = std::min(kAtOnce, end - first), first_index = first - begin;
    PrefetchSplats<kKeep>(frame, first + count, std::min(first + count + kAtOnce, end));
    chunk.Load(frame, first, count);
    for (std::uint32_t blocks = live; blocks != 0; blocks &= blocks - 1) {
      const auto block = static_cast<std::uint32_t>(std::countr_zero(blocks));
      CloseUp(chunk, block, list);
      std::uint32_t needed = 0;
      for (std::uint32_t k = 0; k < kBlockPixels; k += static_cast<std::uint32_t>(hn::Lanes(F()))) {
        const std::uint32_t pixel = block * kBlockPixels + k;
        needed =
            std::max(needed, BlendPixels<kPlanes, kKeep>(frame, list, first_index, pixel, centres, kAtOnce + 1, tile));
      }
      if (needed > kAtOnce) continue;
      live &= ~(1U << block);
      finished_after[block] = first_index + needed;
    }
  }

  const std::size_t row_stride = frame.camera.width;
  for (std::uint32_t c = 0; c < 3; ++c) {
    float values[kPixels];
    for (std::uint32_t i = 0; i < kPixels; ++i) {
      values[i] = tile.planes[c][i] + tile.transmittance[i] * frame.background[c];
    }
    WritePlane<kSide>(area, values, out.color.plane(c), row_stride);
  }
  float alpha[kPixels];
  for (std::uint32_t i = 0; i < kPixels; ++i) alpha[i] = 1.0F - tile.transmittance[i];
  WritePlane<kSide>(area, alpha, out.alpha.plane(0), row_stride);
  if constexpr (kPlanes > 3) {
    if (frame.options.depth) WritePlane<kSide>(area, tile.planes[3], out.depth.plane(0), row_stride);
  }
  if constexpr (kPlanes > 4) {
    for (std::uint32_t c = 0; c < 3; ++c) WritePlane<kSide>(area, tile.planes[4 + c], out.albedo.plane(c), row_stride);
  }
  if constexpr (kKeep) {
    const std::size_t first = std::size_t{tile_index} * kTilePixels;
    std::copy_n(tile.transmittance, kTilePixels, frame.transmittance.data() + first);
    std::copy_n(tile.last, kTilePixels, frame.last_entry.data() + first);
    std::copy_n(finished_after.data(), kTileBlocks, frame.block_entries.data() + std::size_t{tile_index} * kTileBlocks);
  }
}

template <int kPlanes>
void BlendTileKeeping(Frame& frame, std::uint32_t tile, Render& out) {
  frame.keep ? BlendTilePlanes<kPlanes, true>(frame, tile, out) : BlendTilePlanes<kPlanes, false>(frame, tile, out);
}

void BlendTile(Frame& frame, std::uint32_t tile, Render& out) {
  if (frame.options.albedo) return BlendTileKeeping<7>(frame, tile, out);
  if (frame.options.depth) return BlendTileKeeping<4>(frame, tile, out);
  return BlendTileKeeping<3>(frame, tile, out);
}

}  // namespace splatbus::raster::cpu::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace splatbus::raster::cpu {
HWY_EXPORT(BlendTile);
void blend_tile(Frame& frame, std::uint32_t tile, Render& out) {
  HWY_DYNAMIC_DISPATCH(BlendTile)(frame, tile, out);
}
}  // namespace splatbus::raster::cpu
#endif
