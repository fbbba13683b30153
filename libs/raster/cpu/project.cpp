#include <algorithm>
#include <bit>

#include "raster/cpu/kernels.h"

// Highway needs this order.
// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/project.cpp"
#include "hwy/foreach_target.h"
#include "raster/cpu/shading-inl.h"
// clang-format on

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

/// The same as records: quarter q of lane l at values[q][4 l].
struct SplatQuarters {
  HWY_ALIGN float values[4][4 * hn::MaxLanes(F())];

  explicit HWY_INLINE SplatQuarters(const SplatPlanes& planes) {
    for (int q = 0; q < 4; ++q) {
      hn::StoreInterleaved4(planes.Get(4 * q), planes.Get(4 * q + 1), planes.Get(4 * q + 2), planes.Get(4 * q + 3), F(),
                            values[q]);
    }
  }
  HWY_INLINE void CopyLane(std::uint32_t lane, Splat& to) const {
    auto* out = reinterpret_cast<float*>(&to);
    for (std::size_t q = 0; q < 4; ++q) std::copy_n(values[q] + std::size_t{4} * lane, 4, out + 4 * q);
  }
};

/// -0 marks a channel that was clamped, so that the backward pass knows.
HWY_INLINE V ClampColour(V raw) {
  const V zero = hn::Zero(F());
  return hn::IfThenElse(hn::Lt(raw, zero), Splat1(-0.0F), hn::Add(raw, zero));
}

HWY_INLINE M Bounded(V value) {
  return hn::Lt(hn::Abs(value), Splat1(1e15F));
}

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

/// The blocks that ellipses of up to 4x4 tiles reach, exactly: the same cut as in collect.cpp, over Gaussians instead
/// of over rows.
HWY_INLINE void SetReach(const Frame& frame, const Projection& p, V extent_x, V extent_y, V log2_alpha, V uxx, V uxy,
                         V uyy, V rightmost_dy, SplatPlanes& out) {
  const F f;
  const I d;
  const PixelRange rows = RangeOf(p.y, extent_y, frame.camera.height),
                   columns = RangeOf(p.x, extent_x, frame.camera.width);
  const auto to_tile = [&](V pixel) { return hn::ShiftRight<3>(hn::ConvertTo(d, pixel)); };
  const auto tile_x = to_tile(columns.first), tile_y = to_tile(rows.first);
  const auto one = hn::Set(d, 1), eight = hn::Set(d, 8), zero = hn::Zero(d);
  const auto side = hn::Set(d, static_cast<std::int32_t>(TileReach::kSide));
  const auto more_columns = hn::Sub(to_tile(columns.last), tile_x), more_rows = hn::Sub(to_tile(rows.last), tile_y);
  const auto large = hn::Or(hn::Gt(more_columns, hn::Sub(side, one)), hn::Gt(more_rows, hn::Sub(side, one)));
  const auto first_block_column = hn::Add(tile_x, tile_x);
  const V reach2 = hn::Add(log2_alpha, Splat1(7.9943534F + 1e-3F)), inverse_uxx = hn::Div(Splat1(1.0F), uxx);
  const V edge = Splat1(static_cast<float>(frame.camera.width) - 1);
  const V half = Splat1(0.5F), margin = Splat1(0.01F);
  const auto half_width = [&](V dy) {
    const V v = hn::Mul(uyy, dy);
    return hn::Sqrt(hn::Max(hn::NegMulAdd(v, v, reach2), hn::Zero(f)));
  };
  V top = MulScalar(hn::ConvertTo(f, tile_y), float{kTileSide});
  const auto cut_row = [&] {
    const V low = hn::Max(top, rows.first), high = hn::Min(hn::Add(top, Splat1(float{kBlockSide} - 1)), rows.last);
    const V low_dy = hn::Sub(hn::Add(low, half), p.y), high_dy = hn::Sub(hn::Add(high, half), p.y);
    const V right_dy = hn::Min(hn::Max(rightmost_dy, low_dy), high_dy);
    const V left_dy = hn::Min(hn::Max(hn::Neg(rightmost_dy), low_dy), high_dy);
    const V right = hn::MulAdd(hn::NegMulAdd(uxy, right_dy, half_width(right_dy)), inverse_uxx,
                               hn::Add(hn::Sub(p.x, half), margin));
    const V left =
        hn::NegMulAdd(hn::MulAdd(uxy, left_dy, half_width(left_dy)), inverse_uxx, hn::Sub(hn::Sub(p.x, half), margin));
    const V first = hn::Ceil(hn::Min(hn::Max(left, columns.first), hn::Add(edge, Splat1(1.0F))));
    const V last = hn::Floor(hn::Max(hn::Min(right, columns.last), Splat1(-1.0F)));
    const auto none = hn::RebindMask(d, hn::Or(hn::Gt(low, high), hn::Gt(first, last)));
    const auto relative = [&](V column) {
      return hn::Sub(hn::ShiftRight<2>(hn::ConvertTo(d, column)), first_block_column);
    };
    const auto begin = hn::Min(hn::Max(relative(first), zero), eight);
    const auto end = hn::Min(hn::Max(hn::Add(relative(last), one), begin), eight);
    top = hn::Add(top, Splat1(float{kBlockSide}));
    return SpreadPairs(hn::IfThenZeroElse(none, hn::Sub(hn::Shl(one, end), hn::Shl(one, begin))));
  };
  // Two rows of tiles, each of two rows of blocks.
  const auto cut_tiles = [&] {
    auto blocks = cut_row();
    blocks = hn::Or(blocks, hn::ShiftLeft<2>(cut_row()));
    blocks = hn::Or(blocks, hn::ShiftLeft<16>(cut_row()));
    return hn::Or(blocks, hn::ShiftLeft<18>(cut_row()));
  };
  hn::Store(hn::BitCast(U(), cut_tiles()), U(), out.blocks[0]);
  const bool tall = !hn::AllFalse(d, hn::Gt(more_rows, one));
  hn::Store(hn::BitCast(U(), tall ? cut_tiles() : zero), U(), out.blocks[1]);
  auto tile = hn::Add(hn::Mul(tile_y, hn::Set(d, static_cast<std::int32_t>(frame.tiles_x))), tile_x);
  tile = hn::IfThenElse(large, hn::Set(d, -1), tile);
  hn::Store(hn::BitCast(U(), tile), U(), out.tile);
}

/// Gaussians whose geometry is known and whose colour is on its way from memory.
struct Pending {
  std::size_t i, n;
  const ObjectFrame* object;
  M visible;
  SplatPlanes planes;
};

/// Which of `lanes` may be seen, with all but the colours of their Splats in `planes`.
HWY_INLINE M PlaceLanes(const Frame& frame, const ObjectFrame& object, const Columns& in, M lanes,
                        SplatPlanes& planes) {
  const F f;
  const Vec3 mean{in.Load(0), in.Load(1), in.Load(2)};
  const V z = CameraPoint(object, mean).z;
  M visible = hn::And(lanes, hn::And(hn::Gt(z, Splat1(frame.camera.near_m)), Bounded(z)));
  if (hn::AllFalse(f, visible)) return visible;

  const Projection p = Project(frame, object, in);
  visible = hn::And(visible, hn::Ge(p.alpha, Splat1(kAlphaMin)));
  visible = hn::And(visible, hn::And(hn::Gt(p.det_blurred, hn::Zero(f)), hn::Lt(p.det_blurred, Splat1(1e30F))));
  visible = hn::And(visible, hn::And(Bounded(p.x), Bounded(p.y)));
  visible = hn::And(visible, hn::And(Bounded(p.a), Bounded(p.c)));
  if (hn::AllFalse(f, visible)) return visible;

  // U with U^T U = covariance^-1, without cancellation: 1 / sqrt(c) and b are the Schur complement's.
  const V inverse_root_c = hn::Div(Splat1(1.0F), hn::Sqrt(p.c));
  const V uxx = hn::Sqrt(hn::Div(p.c, p.det_blurred));
  const V uxy = hn::Neg(hn::Mul(hn::Mul(p.b, inverse_root_c), hn::Div(Splat1(1.0F), hn::Sqrt(p.det_blurred))));
  const V log2_alpha = hn::Log2(f, p.alpha);
  // Half sides of the box where alpha >= 1/255, with room for rounding.
  const V reach2 = MulScalar(hn::Add(log2_alpha, Splat1(7.9943534F)), 1.3862944F);  // 2 ln(255 alpha)
  const V reach = hn::Sqrt(hn::Max(reach2, hn::Zero(f)));
  const V root_a = hn::Sqrt(p.a), root_c = hn::Sqrt(p.c);
  const V margin = Splat1(1e-2F), slack = Splat1(1.0001F);
  const V extent_x = hn::MulAdd(hn::Mul(reach, root_a), slack, margin);
  const V extent_y = hn::MulAdd(hn::Mul(reach, root_c), slack, margin);
  const V half = Splat1(0.5F);
  visible = hn::And(visible, hn::Ge(hn::Add(p.x, extent_x), half));
  visible = hn::And(visible, hn::Ge(hn::Add(p.y, extent_y), half));
  visible = hn::And(visible, hn::Le(hn::Sub(p.x, extent_x), Splat1(static_cast<float>(frame.camera.width) - 0.5F)));
  visible = hn::And(visible, hn::Le(hn::Sub(p.y, extent_y), Splat1(static_cast<float>(frame.camera.height) - 0.5F)));
  if (hn::AllFalse(f, visible)) return visible;

  planes.Set(0, p.x);
  planes.Set(1, p.y);
  planes.Set(2, log2_alpha);
  planes.Set(3, MulScalar(uxx, kWhiteScale));
  planes.Set(4, MulScalar(uxy, kWhiteScale));
  planes.Set(5, MulScalar(inverse_root_c, kWhiteScale));
  planes.Set(9, z);
  planes.Set(13, extent_x);
  planes.Set(14, extent_y);
  const V rightmost_dy = hn::Div(hn::Mul(reach, p.b), root_a);
  planes.Set(15, rightmost_dy);
  SetReach(frame, p, extent_x, extent_y, log2_alpha, MulScalar(uxx, kWhiteScale), MulScalar(uxy, kWhiteScale),
           MulScalar(inverse_root_c, kWhiteScale), rightmost_dy, planes);
  return visible;
}

/// Shades what was placed, and writes those that may be seen; returns the end of their keys.
HWY_INLINE DepthKey* FinishLanes(Frame& frame, Pending& pending, DepthKey* out) {
  const F f;
  const Columns in{frame.gaussians, pending.i, pending.n};
  SplatPlanes& planes = pending.planes;
  Vec3 colour, albedo{hn::Zero(f), hn::Zero(f), hn::Zero(f)};
  M visible = pending.visible;
  if (in.gaussians.layout.appearance == Appearance::Transfer) {
    albedo = {in.Load(ParameterLayout::kAlbedo), in.Load(ParameterLayout::kAlbedo + 1),
              in.Load(ParameterLayout::kAlbedo + 2)};
    colour = ShadeTransfer(*pending.object, in, albedo);
    visible = hn::And(visible, hn::And(Bounded(albedo.x), hn::And(Bounded(albedo.y), Bounded(albedo.z))));
  } else {
    colour = ShadeRadiance(*pending.object, in, {in.Load(0), in.Load(1), in.Load(2)});
  }
  visible = hn::And(visible, hn::And(Bounded(colour.x), hn::And(Bounded(colour.y), Bounded(colour.z))));
  planes.Set(6, ClampColour(colour.x));
  planes.Set(7, ClampColour(colour.y));
  planes.Set(8, ClampColour(colour.z));
  planes.Set(10, albedo.x);
  planes.Set(11, albedo.y);
  planes.Set(12, albedo.z);
  const SplatQuarters quarters(planes);
  for (std::uint32_t bits = LaneBits(visible); bits != 0; bits &= bits - 1) {
    const auto lane = static_cast<std::uint32_t>(std::countr_zero(bits));
    const auto gaussian = static_cast<std::uint32_t>(pending.i + lane);
    quarters.CopyLane(lane, frame.splats[gaussian]);
    frame.reaches[gaussian] = {planes.tile[lane], {planes.blocks[0][lane], planes.blocks[1][lane]}};
    *out++ = {std::bit_cast<std::uint32_t>(planes.values[9][lane]), gaussian};
  }
  return out;
}

std::size_t ProjectRange(Frame& frame, std::size_t begin, std::size_t end, DepthKey* keys) {
  const F f;
  const std::size_t step = hn::Lanes(f);
  const GaussiansView& gaussians = frame.gaussians;
  DepthKey* out = keys;
  // While one vector's geometry is worked out, the appearance of the one before comes from memory.
  Pending pending[2];
  int turn = 0;
  bool waiting = false;
  std::uint32_t cached_id = 0, cached_frame = gaussians.object_id == nullptr ? 0 : frame.objects.find(0);
  for (std::size_t i = begin; i < end; i += step) {
    const Columns in{gaussians, i, std::min(step, end - i)};
    if (i + 2 * step < end) PrefetchPlanes(gaussians, i + 2 * step, 0, ParameterLayout::kAppearance);
    for (std::size_t k = 0; k < in.n && frame.keep; ++k) frame.pair_ranges[i + k].count = 0;
    M remaining = hn::FirstN(f, in.n);
    std::uint32_t remaining_bits = LaneBits(remaining);
    // Lanes of one object at a time; neighbours nearly always share theirs.
    while (remaining_bits != 0) {
      M lanes = remaining;
      if (gaussians.object_id != nullptr) {
        const std::uint32_t id = gaussians.object_id[i + static_cast<std::size_t>(std::countr_zero(remaining_bits))];
        if (id != cached_id) {
          cached_id = id;
          cached_frame = frame.objects.find(id);
        }
        const auto ids = LoadFirst(U(), gaussians.object_id + i, in.n);
        lanes = hn::And(remaining, hn::RebindMask(f, hn::Eq(ids, hn::Set(U(), id))));
      }
      const std::uint32_t lane_bits = LaneBits(lanes);
      remaining_bits &= ~lane_bits;
      remaining = hn::AndNot(lanes, remaining);
      Pending& placed = pending[turn];
      placed.i = i;
      placed.n = in.n;
      placed.object = &frame.objects[cached_frame];
      placed.visible = PlaceLanes(frame, *placed.object, in, lanes, placed.planes);
      if (hn::AllFalse(f, placed.visible)) continue;
      PrefetchPlanes(gaussians, i, ParameterLayout::kAppearance, gaussians.layout.channels());
      turn ^= 1;
      if (waiting) out = FinishLanes(frame, pending[turn], out);
      waiting = true;
    }
  }
  if (waiting) out = FinishLanes(frame, pending[turn ^ 1], out);
  return static_cast<std::size_t>(out - keys);
}

}  // namespace splatbus::raster::cpu::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace splatbus::raster::cpu {
HWY_EXPORT(ProjectRange);
std::size_t project_range(Frame& frame, std::size_t begin, std::size_t end, DepthKey* visible) {
  return HWY_DYNAMIC_DISPATCH(ProjectRange)(frame, begin, end, visible);
}
}  // namespace splatbus::raster::cpu
#endif
