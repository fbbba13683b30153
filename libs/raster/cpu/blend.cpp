#include <algorithm>
#include <array>
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
template <int kPlanes>
struct TileState {
  alignas(64) float transmittance[kTilePixels];
  alignas(64) std::int32_t last[kTilePixels];
  alignas(64) float planes[kPlanes][kTilePixels];
};

/// Entries of a tile's list looked at at once: their Splats stay in the first level of cache while the tile's blocks
/// take them in turn.
constexpr std::uint32_t kChunk = 64;

/// The entries of a chunk that reach one block, closed up.
struct BlockList {
  std::uint32_t count;
  HWY_ALIGN std::uint32_t gaussian[kChunk + hn::MaxLanes(U())];
  HWY_ALIGN std::uint32_t index[kChunk + hn::MaxLanes(U())];  ///< in the chunk
};

template <bool kKeep>
HWY_INLINE void CloseUp(const TileEntry* entries, std::uint32_t count, std::uint32_t block, BlockList& out) {
  const U u;
  const auto bit = hn::Set(u, 1U << (kBlockShift + block)), mask = hn::Set(u, kGaussianMask);
  out.count = 0;
  for (std::uint32_t k = 0; k < count; k += static_cast<std::uint32_t>(hn::Lanes(u))) {
    const auto inside = hn::FirstN(u, count - k);
    const auto packed = hn::MaskedLoad(inside, u, entries + k);
    const auto reached = hn::TestBit(packed, bit);
    hn::StoreU(hn::Compress(hn::And(packed, mask), reached), u, out.gaussian + out.count);
    if constexpr (kKeep) hn::StoreU(hn::Compress(hn::Iota(u, k), reached), u, out.index + out.count);
    out.count += static_cast<std::uint32_t>(hn::CountTrue(u, reached));
  }
}

/// Blends the Gaussians of a list into one vector of pixels, whose state stays in registers. Returns how many entries
/// of the chunk were needed until no pixel took anything any more (0 where that is not kept), or `unfinished`.
template <int kPlanes, bool kKeep>
HWY_INLINE std::uint32_t BlendPixels(const Frame& frame, const BlockList& list, std::uint32_t first_index,
                                     std::uint32_t pixel, const PixelCentres& centres, std::uint32_t unfinished,
                                     TileState<kPlanes>& tile) {
  const F f;
  const I d;
  const V transmittance_min = Splat1(kTransmittanceMin), log2_alpha_min = Splat1(kLog2AlphaMin);
  const V x = hn::Load(f, centres.x + pixel), y = hn::Load(f, centres.y + pixel);
  V transmittance = hn::Load(f, tile.transmittance + pixel);
  auto last = hn::Load(d, tile.last + pixel);
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
inline TileArea AreaOf(const Frame& frame, std::uint32_t tile) {
  const std::uint32_t x = tile % frame.tiles_x * kTileSide, y = tile / frame.tiles_x * kTileSide;
  return {x, y, std::min(kTileSide, frame.camera.width - x), std::min(kTileSide, frame.camera.height - y)};
}

inline void WritePlane(const TileArea& area, const float* values, float* plane, std::size_t row_stride) {
  if (area.width == kTileSide && area.height == kTileSide) {
    for (std::uint32_t i = 0; i < kTilePixels; i += kBlockSide) {
      std::copy_n(values + i, kBlockSide, plane + (area.y + block_order_y(i)) * row_stride + area.x + block_order_x(i));
    }
    return;
  }
  for (std::uint32_t i = 0; i < kTilePixels; ++i) {
    const std::uint32_t x = block_order_x(i), y = block_order_y(i);
    if (x < area.width && y < area.height) plane[(area.y + y) * row_stride + area.x + x] = values[i];
  }
}

/// Splats of a tile lie apart in memory.
HWY_INLINE void PrefetchSplats(const Frame& frame, std::uint32_t begin, std::uint32_t end) {
  for (std::uint32_t k = begin; k < end; ++k) hwy::Prefetch(&frame.splats[frame.entries[k] & kGaussianMask]);
}

template <int kPlanes, bool kKeep>
void BlendTilePlanes(Frame& frame, std::uint32_t tile_index, Render& out) {
  const TileArea area = AreaOf(frame, tile_index);
  TileState<kPlanes> tile{};
  std::uint32_t live = 0;
  for (std::uint32_t i = 0; i < kTilePixels; ++i) {
    const bool inside = block_order_x(i) < area.width && block_order_y(i) < area.height;
    tile.transmittance[i] = inside ? 1.0F : 0.0F;
    tile.last[i] = inside ? std::numeric_limits<std::int32_t>::max() : -1;
    if (inside) live |= 1U << (i / kBlockPixels);
  }

  const std::uint32_t begin = frame.tile_begin[tile_index], end = frame.tile_begin[tile_index + 1];
  if (tile_index + 1 < frame.tile_count()) {
    PrefetchSplats(frame, end, std::min(end + kChunk / 2, frame.tile_begin[tile_index + 2]));
  }
  std::array<std::uint32_t, kTileBlocks> finished_after;
  for (std::uint32_t b = 0; b < kTileBlocks; ++b) finished_after[b] = (live >> b & 1U) != 0 ? end - begin : 0;
  const PixelCentres centres(area.x, area.y);
  BlockList list;
  for (std::uint32_t chunk = begin; chunk < end && live != 0; chunk += kChunk) {
    const std::uint32_t count = std::min(kChunk, end - chunk), first_index = chunk - begin;
    PrefetchSplats(frame, chunk + count, std::min(chunk + count + kChunk, end));
    for (std::uint32_t block = 0; block < kTileBlocks; ++block) {
      if ((live >> block & 1U) == 0) continue;
      CloseUp<kKeep>(frame.entries.data() + chunk, count, block, list);
      std::uint32_t needed = 0;
      for (std::uint32_t k = 0; k < kBlockPixels; k += static_cast<std::uint32_t>(hn::Lanes(F()))) {
        const std::uint32_t pixel = block * kBlockPixels + k;
        needed =
            std::max(needed, BlendPixels<kPlanes, kKeep>(frame, list, first_index, pixel, centres, kChunk + 1, tile));
      }
      if (needed > kChunk) continue;
      live &= ~(1U << block);
      finished_after[block] = first_index + needed;
    }
  }

  const std::size_t row_stride = frame.camera.width;
  for (std::uint32_t c = 0; c < 3; ++c) {
    float values[kTilePixels];
    for (std::uint32_t i = 0; i < kTilePixels; ++i) {
      values[i] = tile.planes[c][i] + tile.transmittance[i] * frame.background[c];
    }
    WritePlane(area, values, out.color.plane(c), row_stride);
  }
  float alpha[kTilePixels];
  for (std::uint32_t i = 0; i < kTilePixels; ++i) alpha[i] = 1.0F - tile.transmittance[i];
  WritePlane(area, alpha, out.alpha.plane(0), row_stride);
  if constexpr (kPlanes > 3) {
    if (frame.options.depth) WritePlane(area, tile.planes[3], out.depth.plane(0), row_stride);
  }
  if constexpr (kPlanes > 4) {
    for (std::uint32_t c = 0; c < 3; ++c) WritePlane(area, tile.planes[4 + c], out.albedo.plane(c), row_stride);
  }
  if constexpr (!kKeep) return;
  const std::size_t first = std::size_t{tile_index} * kTilePixels;
  std::copy_n(tile.transmittance, kTilePixels, frame.transmittance.data() + first);
  std::copy_n(tile.last, kTilePixels, frame.last_entry.data() + first);
  std::copy_n(finished_after.data(), kTileBlocks, frame.block_entries.data() + std::size_t{tile_index} * kTileBlocks);
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
