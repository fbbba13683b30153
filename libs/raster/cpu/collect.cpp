#include <algorithm>
#include <bit>

#include "raster/cpu/kernels.h"

// Highway needs this order.
// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/collect.cpp"
#include "hwy/foreach_target.h"
#include "hwy/cache_control.h"
#include "raster/cpu/cut-inl.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace splatbus::raster::cpu::HWY_NAMESPACE {

/// Gaussians come in depth order, that is at random in memory.
constexpr std::size_t kPrefetch = 16;

/// A Gaussian that may reach more than a TileReach holds, row after row of tiles.
void CollectLarge(const Frame& frame, std::uint32_t gaussian, PairBuffer& pairs, std::uint32_t* tile_counts) {
  static_assert(kTileSide == 2 * kBlockSide && kBlockSide == 4);
  const Splat& splat = frame.splats[gaussian];
  const RowsToCut rows(splat, frame.camera);
  for (std::int32_t row = rows.first / static_cast<std::int32_t>(kTileSide) * 2; row * 4 <= rows.last; row += kRows) {
    Spans spans;
    CutRows(splat, rows.reach2, static_cast<float>(rows.first), static_cast<float>(rows.last), rows.last_column, row,
            spans);
    for (int pair = 0; pair < kRows; pair += 2) {
      const std::int32_t first = std::min(spans.first[pair], spans.first[pair + 1]) >> 1;
      const std::int32_t last = std::max(spans.last[pair], spans.last[pair + 1]) >> 1;
      if (first > last) continue;
      Pair* out = pairs.room_for(static_cast<std::size_t>(last - first) + 1);
      const std::uint32_t tile_row = static_cast<std::uint32_t>((row + pair) >> 1) * frame.tiles_x;
      for (std::int32_t column = first; column <= last; ++column) {
        const std::uint32_t blocks = spans.Bits(pair, 2 * column) | spans.Bits(pair + 1, 2 * column) << 2U;
        if (blocks == 0) continue;
        const std::uint32_t tile = tile_row + static_cast<std::uint32_t>(column);
        *out++ = {tile, gaussian | blocks << kBlockShift};
        ++tile_counts[tile];
      }
      pairs.commit(out);
    }
  }
}

/// The tiles of a reach, lowest bits first.
HWY_INLINE void CollectReach(const TileReach& reach, std::uint32_t tiles_x, std::uint32_t gaussian, PairBuffer& pairs,
                             std::uint32_t* tile_counts) {
  constexpr int kAtOnce = 4;
  constexpr std::uint64_t kLowBits = 0x1111111111111111U;
  const std::uint64_t blocks = reach.blocks[0] | std::uint64_t{reach.blocks[1]} << 32U;
  std::uint64_t tiles = (blocks | blocks >> 1U | blocks >> 2U | blocks >> 3U) & kLowBits;  // one bit a tile
  Pair* out = pairs.room_for(TileReach::kSide * TileReach::kSide + kAtOnce);
  do {
    // Four at a time without a branch: what is empty is overwritten by the next, and its zero is counted at a tile
    // that exists.
    for (int k = 0; k < kAtOnce; ++k) {
      const std::uint32_t reached = tiles != 0 ? 1 : 0;
      const auto bit = static_cast<std::uint32_t>(std::countr_zero(tiles)) & 63U;
      const std::uint32_t tile = reach.tile + (bit >> 4U) * tiles_x + (bit >> 2U & 3U);
      *out = {tile, gaussian | static_cast<std::uint32_t>(blocks >> bit) << kBlockShift};
      tile_counts[reached != 0 ? tile : 0] += reached;
      out += reached;
      tiles &= tiles - 1;
    }
  } while (tiles != 0);
  pairs.commit(out);
}

void CollectPairs(Frame& frame, std::size_t begin, std::size_t end, std::uint32_t piece, std::size_t most,
                  PairBuffer& pairs, std::uint32_t* tile_counts) {
  const std::uint32_t tiles_x = frame.tiles_x;
  pairs.clear();
  for (std::size_t k = begin; k < end && pairs.size() < most; ++k) {
    if (k + kPrefetch < end) {
      const std::uint32_t ahead = frame.order[k + kPrefetch].gaussian;
      hwy::Prefetch(&frame.reaches[ahead]);
      hwy::Prefetch(&frame.pair_ranges[ahead]);
    }
    const std::uint32_t gaussian = frame.order[k].gaussian;
    const std::size_t before = pairs.size();
    const TileReach reach = frame.reaches[gaussian];
    if (HWY_UNLIKELY(reach.tile == TileReach::kLarge)) {
      CollectLarge(frame, gaussian, pairs, tile_counts);
    } else {
      CollectReach(reach, tiles_x, gaussian, pairs, tile_counts);
    }
    frame.pair_ranges[gaussian] = {static_cast<std::uint32_t>(pairs.size() - before), piece,
                                   static_cast<std::uint32_t>(before)};
  }
}

}  // namespace splatbus::raster::cpu::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace splatbus::raster::cpu {
HWY_EXPORT(CollectPairs);
void collect_pairs(Frame& frame, std::size_t begin, std::size_t end, std::uint32_t piece, std::size_t most,
                   PairBuffer& pairs, std::uint32_t* tile_counts) {
  HWY_DYNAMIC_DISPATCH(CollectPairs)(frame, begin, end, piece, most, pairs, tile_counts);
}
}  // namespace splatbus::raster::cpu
#endif
