#include <algorithm>
#include <array>
#include <bit>

#include "raster/cpu/kernels.h"

// Highway needs this order.
// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/blend_backward.cpp"
#include "hwy/foreach_target.h"
#include "raster/cpu/alpha-inl.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace splatbus::raster::cpu::HWY_NAMESPACE {

#if HWY_TARGET != HWY_SCALAR
/// The sum of a vector's 128-bit blocks.
template <class D>
HWY_INLINE void StoreBlockSum(D d, hn::Vec<D> value, float* out) {
  if constexpr (hn::MaxLanes(d) > 4) {
    const hn::Half<D> half;
    StoreBlockSum(half, hn::Add(hn::LowerHalf(half, value), hn::UpperHalf(half, value)), out);
  } else {
    hn::StoreU(value, d, out);
  }
}
#endif

/// Sums of four vectors over all lanes, as four floats.
HWY_INLINE void SumLanes4(V a, V b, V c, V d, float* out) {
#if HWY_TARGET == HWY_SCALAR
  out[0] = hn::GetLane(a);
  out[1] = hn::GetLane(b);
  out[2] = hn::GetLane(c);
  out[3] = hn::GetLane(d);
#else
  const F f;
  const hn::Repartition<double, F> f64;
  // a0+a2 b0+b2 a1+a3 b1+b3 in every 128-bit block, then a b c d.
  const V ab = hn::Add(hn::InterleaveLower(f, a, b), hn::InterleaveUpper(f, a, b));
  const V cd = hn::Add(hn::InterleaveLower(f, c, d), hn::InterleaveUpper(f, c, d));
  const auto ab64 = hn::BitCast(f64, ab), cd64 = hn::BitCast(f64, cd);
  const V sum = hn::Add(hn::BitCast(f, hn::InterleaveLower(f64, ab64, cd64)),
                        hn::BitCast(f, hn::InterleaveUpper(f64, ab64, cd64)));
  StoreBlockSum(f, sum, out);
#endif
}

template <int kPlanes>
struct TileState {
  alignas(64) float transmittance[kTilePixels];
  alignas(
      64) float behind[kTilePixels];  ///< gradient dot what lies behind the current Gaussian, per unit transmittance
  alignas(64) std::int32_t last[kTilePixels];
  alignas(64) float gradient[kPlanes][kTilePixels];
};

/// Splats of a tile lie apart in memory.
constexpr std::uint32_t kPrefetchEntries = 8;

struct Sums {
  V s, su, sv, suu, suv, svv, largest;
};

template <int kPlanes>
HWY_INLINE void BlendBlockBackward(const Splat& splat, const PixelCentres<>& centres, std::uint32_t block,
                                   std::int32_t index, TileState<kPlanes>& tile, Sums& sums, V* plane_sums, M& any) {
  const F f;
  const I d;
  const V one = Splat1(1.0F), alpha_max = Splat1(kAlphaMax);
  const std::uint32_t begin = block * kBlockPixels;
  for (std::uint32_t pixel = begin; pixel < begin + kBlockPixels; pixel += hn::Lanes(f)) {
    const Footprint footprint = Evaluate(splat, hn::Load(f, centres.x + pixel), hn::Load(f, centres.y + pixel));
    const M before_end = hn::RebindMask(f, hn::Gt(hn::Load(d, tile.last + pixel), hn::Set(d, index - 1)));
    const M taken = hn::And(hn::Ge(footprint.log2_alpha, Splat1(kLog2AlphaMin)), before_end);
    if (hn::AllFalse(f, taken)) continue;
    any = hn::Or(any, taken);
    const V unclamped = hn::IfThenElseZero(taken, Exp2(footprint.log2_alpha));
    const V alpha = hn::Min(unclamped, alpha_max);
    const V transmittance = hn::Mul(hn::Load(f, tile.transmittance + pixel), Reciprocal(hn::Sub(one, alpha)));
    hn::Store(transmittance, f, tile.transmittance + pixel);
    const V weight = hn::Mul(alpha, transmittance);
    sums.largest = hn::Max(sums.largest, weight);

    const float* colour = &splat.red;
    V own = hn::Mul(Splat1(colour[0]), hn::Load(f, tile.gradient[0] + pixel));
    for (int c = 1; c < kPlanes; ++c) own = hn::MulAdd(Splat1(colour[c]), hn::Load(f, tile.gradient[c] + pixel), own);
    for (int c = 0; c < kPlanes; ++c) {
      plane_sums[c] = hn::MulAdd(weight, hn::Load(f, tile.gradient[c] + pixel), plane_sums[c]);
    }
    const V behind = hn::Load(f, tile.behind + pixel);
    const V difference = hn::Sub(own, behind);
    hn::Store(hn::MulAdd(alpha, difference, behind), f, tile.behind + pixel);

    // dL/dalpha = T (own - behind); alpha = exp(..), so its derivative by the exponent is alpha, or 0 where clamped.
    const V s = hn::IfThenElseZero(hn::Le(unclamped, alpha_max), hn::Mul(weight, difference));
    const V su = hn::Mul(s, footprint.u), sv = hn::Mul(s, footprint.v);
    sums.s = hn::Add(sums.s, s);
    sums.su = hn::Add(sums.su, su);
    sums.sv = hn::Add(sums.sv, sv);
    sums.suu = hn::MulAdd(su, footprint.u, sums.suu);
    sums.suv = hn::MulAdd(su, footprint.v, sums.suv);
    sums.svv = hn::MulAdd(sv, footprint.v, sums.svv);
  }
}

/// The same of a Gaussian that gets no gradient: what lies in front of it is still to know what it hides.
template <int kPlanes>
HWY_INLINE void PassBlockBackward(const Splat& splat, const PixelCentres<>& centres, std::uint32_t block,
                                  std::int32_t index, TileState<kPlanes>& tile) {
  const F f;
  const I d;
  const V one = Splat1(1.0F), alpha_max = Splat1(kAlphaMax);
  const std::uint32_t begin = block * kBlockPixels;
  for (std::uint32_t pixel = begin; pixel < begin + kBlockPixels; pixel += hn::Lanes(f)) {
    const Footprint footprint = Evaluate(splat, hn::Load(f, centres.x + pixel), hn::Load(f, centres.y + pixel));
    const M before_end = hn::RebindMask(f, hn::Gt(hn::Load(d, tile.last + pixel), hn::Set(d, index - 1)));
    const M taken = hn::And(hn::Ge(footprint.log2_alpha, Splat1(kLog2AlphaMin)), before_end);
    if (hn::AllFalse(f, taken)) continue;
    const V alpha = hn::Min(hn::IfThenElseZero(taken, Exp2(footprint.log2_alpha)), alpha_max);
    const V transmittance = hn::Mul(hn::Load(f, tile.transmittance + pixel), Reciprocal(hn::Sub(one, alpha)));
    hn::Store(transmittance, f, tile.transmittance + pixel);
    const float* colour = &splat.red;
    V own = hn::Mul(Splat1(colour[0]), hn::Load(f, tile.gradient[0] + pixel));
    for (int c = 1; c < kPlanes; ++c) own = hn::MulAdd(Splat1(colour[c]), hn::Load(f, tile.gradient[c] + pixel), own);
    const V behind = hn::Load(f, tile.behind + pixel);
    hn::Store(hn::MulAdd(alpha, hn::Sub(own, behind), behind), f, tile.behind + pixel);
  }
}

/// Reads a gradient plane into block order; pixels outside the image get 0.
inline void ReadPlane(const Image& image, std::uint32_t plane, std::uint32_t x0, std::uint32_t y0, float* values) {
  const float* from = image.plane(plane);
  if (x0 + kTileSide <= image.width && y0 + kTileSide <= image.height) {
    for (std::uint32_t i = 0; i < kTilePixels; i += kBlockSide) {
      const std::size_t row = y0 + block_order_y(i);
      std::copy_n(from + row * image.width + x0 + block_order_x(i), kBlockSide, values + i);
    }
    return;
  }
  for (std::uint32_t i = 0; i < kTilePixels; ++i) {
    const std::uint32_t x = x0 + block_order_x(i), y = y0 + block_order_y(i);
    const bool inside = x < image.width && y < image.height;
    values[i] = inside ? from[std::size_t{y} * image.width + x] : 0.0F;
  }
}

template <int kPlanes>
void LoadTile(const Frame& frame, std::uint32_t tile_index, const RenderGradient& gradient, TileState<kPlanes>& tile) {
  const std::uint32_t x0 = tile_index % frame.tiles_x * kTileSide, y0 = tile_index / frame.tiles_x * kTileSide;
  const std::size_t first = std::size_t{tile_index} * kTilePixels;
  std::copy_n(frame.transmittance.data() + first, kTilePixels, tile.transmittance);
  std::copy_n(frame.last_entry.data() + first, kTilePixels, tile.last);
  if (gradient.color.channels == 3) {
    for (std::uint32_t c = 0; c < 3; ++c) ReadPlane(gradient.color, c, x0, y0, tile.gradient[c]);
  }
  if constexpr (kPlanes > 3) {
    if (gradient.depth.channels == 1) ReadPlane(gradient.depth, 0, x0, y0, tile.gradient[3]);
  }
  if constexpr (kPlanes > 4) {
    if (gradient.albedo.channels == 3) {
      for (std::uint32_t c = 0; c < 3; ++c) ReadPlane(gradient.albedo, c, x0, y0, tile.gradient[4 + c]);
    }
  }
  // Behind the last Gaussian lies the background; alpha = 1 - T.
  float alpha_gradient[kTilePixels] = {};
  if (gradient.alpha.channels == 1) ReadPlane(gradient.alpha, 0, x0, y0, alpha_gradient);
  for (std::uint32_t i = 0; i < kTilePixels; ++i) {
    tile.behind[i] = frame.background[0] * tile.gradient[0][i] + frame.background[1] * tile.gradient[1][i] +
                     frame.background[2] * tile.gradient[2][i] - alpha_gradient[i];
  }
}

template <int kPlanes>
void BlendTileBackwardPlanes(Frame& frame, std::uint32_t tile_index, const RenderGradient& gradient) {
  const F f;
  const std::uint32_t* block_entries = frame.block_entries.data() + std::size_t{tile_index} * kTileBlocks;
  const std::uint32_t first_entry = frame.tile_begin[tile_index];
  std::fill(frame.pair_written.data() + first_entry, frame.pair_written.data() + frame.tile_begin[tile_index + 1],
            std::uint8_t{0});
  const std::uint32_t processed = *std::max_element(block_entries, block_entries + kTileBlocks);
  const TileEntry* entries = frame.entries.data() + first_entry;
  const auto is_frozen = [&](std::uint32_t k) {
    return !frame.frozen_page.empty() &&
           frame.frozen_page[(entries[k] & kGaussianMask) >> frame.gaussians.page_shift] != 0;
  };
  // Nothing in front of the nearest that moves is of interest, nor is a tile without any.
  std::uint32_t nearest = 0;
  while (nearest < processed && is_frozen(nearest)) ++nearest;
  if (nearest == processed) return;
  TileState<kPlanes> tile{};
  LoadTile(frame, tile_index, gradient, tile);
  const std::uint32_t row = tile_index / frame.tiles_x, column = tile_index % frame.tiles_x;
  const PixelCentres<> centres(column * kTileSide, row * kTileSide);

  std::uint32_t live = 0, next_change = processed;  // from the entry before it on, more blocks take part
  for (std::uint32_t k = processed; k-- > nearest;) {
    if (k >= kPrefetchEntries) {
      hwy::Prefetch(&frame.splats[entries[k - kPrefetchEntries] & kGaussianMask]);
    }
    if (k + 1 == next_change) {
      next_change = 0;
      for (std::uint32_t b = 0; b < kTileBlocks; ++b) {
        if (block_entries[b] > k) {
          live |= 1U << b;
        } else {
          next_change = std::max(next_change, block_entries[b]);
        }
      }
    }
    std::uint32_t blocks = entries[k] >> kBlockShift & live;
    if (blocks == 0) continue;
    const Splat& splat = frame.splats[entries[k] & kGaussianMask];
    if (is_frozen(k)) {
      for (; blocks != 0; blocks &= blocks - 1) {
        const auto block = static_cast<std::uint32_t>(std::countr_zero(blocks));
        PassBlockBackward<kPlanes>(splat, centres, block, static_cast<std::int32_t>(k), tile);
      }
      continue;
    }
    const V zero = hn::Zero(f);
    Sums sums{zero, zero, zero, zero, zero, zero, zero};
    V planes[8] = {zero, zero, zero, zero, zero, zero, zero, zero};
    M any = hn::FirstN(f, 0);
    for (; blocks != 0; blocks &= blocks - 1) {
      const auto block = static_cast<std::uint32_t>(std::countr_zero(blocks));
      BlendBlockBackward<kPlanes>(splat, centres, block, static_cast<std::int32_t>(k), tile, sums, planes, any);
    }
    if (hn::AllFalse(f, any)) continue;
    auto* record = reinterpret_cast<float*>(&frame.pair_gradients[first_entry + k]);
    SumLanes4(sums.s, sums.su, sums.sv, sums.suu, record);
    SumLanes4(sums.suv, sums.svv, planes[0], planes[1], record + 4);
    if constexpr (kPlanes > 3) {
      SumLanes4(planes[2], planes[3], planes[4], planes[5], record + 8);
    } else {
      record[8] = hn::GetLane(hn::SumOfLanes(f, planes[2]));
      std::fill_n(record + 9, 3, 0.0F);
    }
    record[12] = kPlanes > 4 ? hn::GetLane(hn::SumOfLanes(f, planes[6])) : 0.0F;
    record[13] = hn::GetLane(hn::MaxOfLanes(f, sums.largest));
    frame.pair_written[first_entry + k] = 1;
  }
}

void BlendTileBackward(Frame& frame, std::uint32_t tile, const RenderGradient& gradient) {
  if (frame.options.albedo) return BlendTileBackwardPlanes<7>(frame, tile, gradient);
  if (frame.options.depth) return BlendTileBackwardPlanes<4>(frame, tile, gradient);
  return BlendTileBackwardPlanes<3>(frame, tile, gradient);
}

}  // namespace splatbus::raster::cpu::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace splatbus::raster::cpu {
HWY_EXPORT(BlendTileBackward);
void blend_tile_backward(Frame& frame, std::uint32_t tile, const RenderGradient& gradient) {
  HWY_DYNAMIC_DISPATCH(BlendTileBackward)(frame, tile, gradient);
}
}  // namespace splatbus::raster::cpu
#endif
