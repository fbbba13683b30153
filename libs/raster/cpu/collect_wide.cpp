#include <algorithm>

#include "raster/cpu/kernels.h"

// Highway needs this order.
// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/collect_wide.cpp"
#include "hwy/foreach_target.h"
#include "hwy/cache_control.h"
#include "raster/cpu/cut-inl.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace splatbus::raster::cpu::HWY_NAMESPACE {

constexpr int kTileBlockRows = kWideSide / kBlockSide;
static_assert(kTileBlockRows == kRows, "a row of tiles is cut at once");
/// Gaussians come in depth order, that is at random in memory.
constexpr std::size_t kPrefetch = 16;

/// Bits of the blocks [first, last] among the four from `column` on.
HWY_INLINE std::uint32_t NibbleOf(std::int32_t first, std::int32_t last, std::int32_t column) {
  const std::int32_t begin = std::clamp(first - column, 0, kTileBlockRows);
  const std::int32_t end = std::clamp(last + 1 - column, begin, kTileBlockRows);
  return (1U << static_cast<std::uint32_t>(end)) - (1U << static_cast<std::uint32_t>(begin));
}

/// A Gaussian that may reach more than a TileReach holds, row after row of tiles.
void CollectLarge(const Frame& frame, std::uint32_t gaussian, WidePairBuffer& pairs, std::uint32_t* tile_counts) {
  const Splat& splat = frame.splats[gaussian];
  const RowsToCut rows(splat, frame.camera);
  constexpr auto kSide = static_cast<std::int32_t>(kWideSide);
  for (std::int32_t tile_row = rows.first / kSide; tile_row * kSide <= rows.last; ++tile_row) {
    Spans spans;
    CutRows(splat, rows.reach2, static_cast<float>(rows.first), static_cast<float>(rows.last), rows.last_column,
            tile_row * kRows, spans);
    const std::int32_t first = *std::min_element(spans.first, spans.first + kRows) / kTileBlockRows;
    const std::int32_t last = *std::max_element(spans.last, spans.last + kRows);
    if (last < 0 || first > last / kTileBlockRows) continue;
    WidePair* out = pairs.room_for(static_cast<std::size_t>(last / kTileBlockRows - first) + 1);
    for (std::int32_t column = first; column <= last / kTileBlockRows; ++column) {
      std::uint32_t blocks = 0;
      for (int row = 0; row < kRows; ++row) {
        blocks |= NibbleOf(spans.first[row], spans.last[row], column * kTileBlockRows)
                  << static_cast<std::uint32_t>(row * kTileBlockRows);
      }
      if (blocks == 0) continue;
      const std::uint32_t tile =
          static_cast<std::uint32_t>(tile_row) * frame.tiles_x + static_cast<std::uint32_t>(column);
      *out++ = {tile, gaussian, blocks};
      ++tile_counts[tile];
    }
    pairs.commit(out);
  }
}

void CollectWidePairs(Frame& frame, std::size_t begin, std::size_t end, std::size_t most, WidePairBuffer& pairs,
                      std::uint32_t* tile_counts) {
  const std::uint32_t tiles_x = frame.tiles_x;
  pairs.clear();
  for (std::size_t k = begin; k < end && pairs.size() < most; ++k) {
    if (k + kPrefetch < end) hwy::Prefetch(&frame.reaches[frame.order[k + kPrefetch].gaussian]);
    const std::uint32_t gaussian = frame.order[k].gaussian;
    const TileReach reach = frame.reaches[gaussian];
    if (HWY_UNLIKELY(reach.tile == TileReach::kLarge)) {
      CollectLarge(frame, gaussian, pairs, tile_counts);
      continue;
    }
    // Without a branch: what is empty is overwritten by the next, and its zero is counted at a tile that exists.
    WidePair* out = pairs.room_for(4);
    const auto put = [&](std::uint32_t tile, std::uint32_t blocks) {
      const std::uint32_t reached = blocks != 0 ? 1 : 0;
      *out = {tile, gaussian, blocks};
      tile_counts[reached != 0 ? tile : 0] += reached;
      out += reached;
    };
    put(reach.tile, reach.blocks[0] & 0xFFFFU);
    put(reach.tile + 1, reach.blocks[0] >> 16U);
    put(reach.tile + tiles_x, reach.blocks[1] & 0xFFFFU);
    put(reach.tile + tiles_x + 1, reach.blocks[1] >> 16U);
    pairs.commit(out);
  }
}

}  // namespace splatbus::raster::cpu::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace splatbus::raster::cpu {
HWY_EXPORT(CollectWidePairs);
void collect_wide_pairs(Frame& frame, std::size_t begin, std::size_t end, std::size_t most, WidePairBuffer& pairs,
                        std::uint32_t* tile_counts) {
  HWY_DYNAMIC_DISPATCH(CollectWidePairs)(frame, begin, end, most, pairs, tile_counts);
}
}  // namespace splatbus::raster::cpu
#endif
