// The blocks that Gaussians reach, a vector of Gaussians at a time; included once a Highway target.
#if defined(SPLATBUS_RASTER_REACH_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SPLATBUS_RASTER_REACH_INL_H
#undef SPLATBUS_RASTER_REACH_INL_H
#else
#define SPLATBUS_RASTER_REACH_INL_H
#endif

#include "raster/cpu/projection-inl.h"

HWY_BEFORE_NAMESPACE();
namespace splatbus::raster::cpu::HWY_NAMESPACE {

/// The Splats and reaches of a vector of Gaussians, as planes of fields.
struct SplatPlanes {
  HWY_ALIGN float values[16][hn::MaxLanes(F())];
  HWY_ALIGN std::uint32_t tile[hn::MaxLanes(F())];
  HWY_ALIGN std::uint32_t blocks[2][hn::MaxLanes(F())];

  HWY_INLINE void Set(int field, V value) { hn::Store(value, F(), values[field]); }
  [[nodiscard]] HWY_INLINE V Get(int field) const { return hn::Load(F(), values[field]); }
};

/// The pixels' rows or columns [first, last] whose centres lie within `extent` of `centre`.
struct PixelRange {
  V first, last;
};
HWY_INLINE PixelRange RangeOf(V centre, V extent, std::uint32_t size) {
  const V edge = Splat1(static_cast<float>(size) - 1), half = Splat1(0.5F);
  return {hn::Floor(hn::Max(hn::Add(hn::Sub(centre, extent), half), hn::Zero(F()))),
          hn::Floor(hn::Min(hn::Sub(hn::Add(centre, extent), half), edge))};
}

/// Eight bits, a pair a tile, to the lower two bits of four nibbles.
HWY_INLINE hn::Vec<I> SpreadPairs(hn::Vec<I> bits) {
  const I d;
  bits = hn::And(hn::Or(bits, hn::ShiftLeft<4>(bits)), hn::Set(d, 0x0F0F));
  return hn::And(hn::Or(bits, hn::ShiftLeft<2>(bits)), hn::Set(d, 0x3333));
}

/// Eight bits, a nibble a wide tile, to the lowest nibbles of two halves.
HWY_INLINE hn::Vec<I> SpreadNibbles(hn::Vec<I> bits) {
  const I d;
  return hn::Or(hn::And(bits, hn::Set(d, 0xF)), hn::ShiftLeft<12>(hn::And(bits, hn::Set(d, 0xF0))));
}

/// The blocks that ellipses reach, exactly: the same cut as in cut-inl.h, over Gaussians instead of over rows. They lie
/// in a square of 8x8 blocks that begins at a tile's corner, or are large.
template <bool kKeep>
HWY_INLINE void SetReach(const Frame& frame, const Projection& p, V extent_x, V extent_y, V rightmost_dy,
                         ChannelFetch& fetch, SplatPlanes& out) {
  constexpr int kTileShift = kKeep ? 3 : 4;
  constexpr std::int32_t kTiles = kKeep ? TileReach::kSide : TileReach::kWideTiles;  // along a side of the square
  static_assert(tile_side(kKeep) == 1U << kTileShift && (kTiles << kTileShift) == 8 * kBlockSide);
  const F f;
  const I d;
  const V log2_alpha = out.Get(2), uxx = out.Get(3), uxy = out.Get(4), uyy = out.Get(5);
  const PixelRange rows = RangeOf(p.y, extent_y, frame.camera.height),
                   columns = RangeOf(p.x, extent_x, frame.camera.width);
  const auto to_tile = [&](V pixel) { return hn::ShiftRight<kTileShift>(hn::ConvertTo(d, pixel)); };
  const auto tile_x = to_tile(columns.first), tile_y = to_tile(rows.first);
  const auto one = hn::Set(d, 1), eight = hn::Set(d, 8), zero = hn::Zero(d);
  const auto more_columns = hn::Sub(to_tile(columns.last), tile_x), more_rows = hn::Sub(to_tile(rows.last), tile_y);
  const auto most = hn::Set(d, kTiles - 1);
  const auto large = hn::Or(hn::Gt(more_columns, most), hn::Gt(more_rows, most));
  const auto first_block_column = hn::ShiftLeft<kTileShift - 2>(tile_x);
  const V reach2 = hn::Add(log2_alpha, Splat1(7.9943534F + 1e-3F)), inverse_uxx = hn::Div(Splat1(1.0F), uxx);
  const V edge = Splat1(static_cast<float>(frame.camera.width) - 1);
  const V half = Splat1(0.5F), margin = Splat1(0.01F), least = Splat1(1e-12F);
  // The estimate is off by 4e-4 of some pixels at most, which the margin covers.
  const auto half_width = [&](V dy) {
    const V v = hn::Mul(uyy, dy);
    const V square = hn::Max(hn::NegMulAdd(v, v, reach2), least);
    return hn::Mul(square, hn::ApproximateReciprocalSqrt(square));
  };
  V top = MulScalar(hn::ConvertTo(f, tile_y), float{1U << kTileShift});
  const auto cut_row = [&] {
    fetch.Some(7);
    const V low = hn::Max(top, rows.first), high = hn::Min(hn::Add(top, Splat1(float{kBlockSide} - 1)), rows.last);
    top = hn::Add(top, Splat1(float{kBlockSide}));
    const M no_rows = hn::Gt(low, high);
    if (hn::AllTrue(f, no_rows)) return zero;
    const V low_dy = hn::Sub(hn::Add(low, half), p.y), high_dy = hn::Sub(hn::Add(high, half), p.y);
    const V right_dy = hn::Min(hn::Max(rightmost_dy, low_dy), high_dy);
    const V left_dy = hn::Min(hn::Max(hn::Neg(rightmost_dy), low_dy), high_dy);
    const V right = hn::MulAdd(hn::NegMulAdd(uxy, right_dy, half_width(right_dy)), inverse_uxx,
                               hn::Add(hn::Sub(p.x, half), margin));
    const V left =
        hn::NegMulAdd(hn::MulAdd(uxy, left_dy, half_width(left_dy)), inverse_uxx, hn::Sub(hn::Sub(p.x, half), margin));
    const V first = hn::Ceil(hn::Min(hn::Max(left, columns.first), hn::Add(edge, Splat1(1.0F))));
    const V last = hn::Floor(hn::Max(hn::Min(right, columns.last), Splat1(-1.0F)));
    const auto none = hn::RebindMask(d, hn::Or(no_rows, hn::Gt(first, last)));
    const auto relative = [&](V column) {
      return hn::Sub(hn::ShiftRight<2>(hn::ConvertTo(d, column)), first_block_column);
    };
    const auto begin = hn::Min(hn::Max(relative(first), zero), eight);
    const auto end = hn::Min(hn::Max(hn::Add(relative(last), one), begin), eight);
    return hn::IfThenZeroElse(none, hn::Sub(hn::Shl(one, end), hn::Shl(one, begin)));
  };
  // Four rows of blocks: two rows of tiles, or one of wide tiles.
  const auto cut_rows = [&] {
    if constexpr (kKeep) {
      auto blocks = SpreadPairs(cut_row());
      blocks = hn::Or(blocks, hn::ShiftLeft<2>(SpreadPairs(cut_row())));
      blocks = hn::Or(blocks, hn::ShiftLeft<16>(SpreadPairs(cut_row())));
      return hn::Or(blocks, hn::ShiftLeft<18>(SpreadPairs(cut_row())));
    } else {
      auto blocks = SpreadNibbles(cut_row());
      blocks = hn::Or(blocks, hn::ShiftLeft<4>(SpreadNibbles(cut_row())));
      blocks = hn::Or(blocks, hn::ShiftLeft<8>(SpreadNibbles(cut_row())));
      return hn::Or(blocks, hn::ShiftLeft<12>(SpreadNibbles(cut_row())));
    }
  };
  hn::Store(hn::BitCast(U(), cut_rows()), U(), out.blocks[0]);
  const bool tall = !hn::AllFalse(d, hn::Gt(more_rows, hn::Set(d, kTiles / 2 - 1)));
  hn::Store(hn::BitCast(U(), tall ? cut_rows() : zero), U(), out.blocks[1]);
  auto tile = hn::Add(hn::Mul(tile_y, hn::Set(d, static_cast<std::int32_t>(frame.tiles_x))), tile_x);
  tile = hn::IfThenElse(large, hn::Set(d, -1), tile);
  hn::Store(hn::BitCast(U(), tile), U(), out.tile);
}

}  // namespace splatbus::raster::cpu::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();
#endif
