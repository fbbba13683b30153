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

/// What the blended planes of a Splat are: red green blue | depth | albedo.
template <int kPlanes>
struct TileState {
  alignas(64) float transmittance[kTilePixels];
  alignas(64) std::int32_t last[kTilePixels];
  alignas(64) float planes[kPlanes][kTilePixels];
};

/// Blends one Gaussian into one block; false when no pixel of the block takes anything any more.
template <int kPlanes>
HWY_INLINE bool BlendBlock(const TileGaussian& gaussian, const float* colour, std::uint32_t block, std::int32_t index,
                           TileState<kPlanes>& tile) {
  const F f;
  const V transmittance_min = Splat1(kTransmittanceMin);
  bool unfinished = true;
  const std::uint32_t begin = block * kBlockPixels;
  for (std::uint32_t pixel = begin; pixel < begin + kBlockPixels; pixel += hn::Lanes(f)) {
    const Footprint footprint = Evaluate(gaussian, pixel);
    const V transmittance = hn::Load(f, tile.transmittance + pixel);
    const M taken =
        hn::And(hn::Ge(footprint.log2_alpha, Splat1(kLog2AlphaMin)), hn::Ge(transmittance, transmittance_min));
    if (hn::AllFalse(f, taken)) continue;
    const V alpha = hn::IfThenElseZero(taken, hn::Min(Exp2(footprint.log2_alpha), Splat1(kAlphaMax)));
    const V weight = hn::Mul(alpha, transmittance);
    const V after = hn::Sub(transmittance, weight);
    hn::Store(after, f, tile.transmittance + pixel);
    for (int c = 0; c < kPlanes; ++c) {
      float* plane = tile.planes[c] + pixel;
      hn::Store(hn::MulAdd(Splat1(colour[c]), weight, hn::Load(f, plane)), f, plane);
    }
    const M ended = hn::And(taken, hn::Lt(after, transmittance_min));
    if (HWY_UNLIKELY(!hn::AllFalse(f, ended))) {
      const I d;
      const auto last = hn::Load(d, tile.last + pixel);
      hn::Store(hn::IfThenElse(hn::RebindMask(d, ended), hn::Set(d, index), last), d, tile.last + pixel);
      unfinished = false;
    }
  }
  if (HWY_LIKELY(unfinished)) return true;
  for (std::uint32_t pixel = begin; pixel < begin + kBlockPixels; pixel += hn::Lanes(f)) {
    if (!hn::AllTrue(f, hn::Lt(hn::Load(f, tile.transmittance + pixel), transmittance_min))) return true;
  }
  return false;
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
  for (std::uint32_t i = 0; i < kTilePixels; ++i) {
    const std::uint32_t x = block_order_x(i), y = block_order_y(i);
    if (x < area.width && y < area.height) plane[(area.y + y) * row_stride + area.x + x] = values[i];
  }
}

template <int kPlanes>
void BlendTilePlanes(Frame& frame, std::uint32_t tile_index, bool keep, Render& out) {
  const TileArea area = AreaOf(frame, tile_index);
  TileState<kPlanes> tile{};
  std::uint32_t live = 0;
  for (std::uint32_t i = 0; i < kTilePixels; ++i) {
    const bool inside = block_order_x(i) < area.width && block_order_y(i) < area.height;
    tile.transmittance[i] = inside ? 1.0F : 0.0F;
    tile.last[i] = inside ? std::numeric_limits<std::int32_t>::max() : -1;
    if (inside) live |= 1U << (i / kBlockPixels);
  }

  const std::uint32_t begin = frame.tile_begin[tile_index], count = frame.tile_begin[tile_index + 1] - begin;
  const TileEntry* entries = frame.entries.data() + begin;
  std::array<std::uint32_t, kTileBlocks> finished_after;
  for (std::uint32_t b = 0; b < kTileBlocks; ++b) finished_after[b] = (live >> b & 1U) != 0 ? count : 0;
  const auto corner_x = static_cast<float>(area.x), corner_y = static_cast<float>(area.y);
  for (std::uint32_t k = 0; k < count && live != 0; ++k) {
    if (k + kPrefetchEntries < count) {
      hwy::Prefetch(&frame.splats[entries[k + kPrefetchEntries].gaussian_and_blocks & kGaussianMask]);
    }
    const std::uint32_t packed = entries[k].gaussian_and_blocks;
    std::uint32_t blocks = packed >> kBlockShift & live;
    if (blocks == 0) continue;
    const Splat& splat = frame.splats[packed & kGaussianMask];
    const TileGaussian gaussian(splat, corner_x, corner_y);
    for (; blocks != 0; blocks &= blocks - 1) {
      const auto block = static_cast<std::uint32_t>(std::countr_zero(blocks));
      if (HWY_LIKELY(BlendBlock<kPlanes>(gaussian, &splat.red, block, static_cast<std::int32_t>(k), tile))) continue;
      live &= ~(1U << block);
      finished_after[block] = k + 1;
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
  if (!keep) return;
  const std::size_t first = std::size_t{tile_index} * kTilePixels;
  std::copy_n(tile.transmittance, kTilePixels, frame.transmittance.data() + first);
  std::copy_n(tile.last, kTilePixels, frame.last_entry.data() + first);
  std::copy_n(finished_after.data(), kTileBlocks, frame.block_entries.data() + std::size_t{tile_index} * kTileBlocks);
}

void BlendTile(Frame& frame, std::uint32_t tile, bool keep, Render& out) {
  if (frame.options.albedo) return BlendTilePlanes<7>(frame, tile, keep, out);
  if (frame.options.depth) return BlendTilePlanes<4>(frame, tile, keep, out);
  return BlendTilePlanes<3>(frame, tile, keep, out);
}

}  // namespace splatbus::raster::cpu::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace splatbus::raster::cpu {
HWY_EXPORT(BlendTile);
void blend_tile(Frame& frame, std::uint32_t tile, bool keep, Render& out) {
  HWY_DYNAMIC_DISPATCH(BlendTile)(frame, tile, keep, out);
}
}  // namespace splatbus::raster::cpu
#endif
