// Alpha of a Gaussian in the pixels of a tile, identical in forward and backward; included once a Highway target.
#if defined(SPLATBUS_RASTER_ALPHA_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SPLATBUS_RASTER_ALPHA_INL_H
#undef SPLATBUS_RASTER_ALPHA_INL_H
#else
#define SPLATBUS_RASTER_ALPHA_INL_H
#endif

#include "hwy/cache_control.h"
#include "raster/cpu/frame.h"
#include "raster/cpu/lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace splatbus::raster::cpu::HWY_NAMESPACE {

constexpr float kLog2AlphaMin = -7.994353436858858F;

/// Positions of a tile's pixel centres, relative to the tile's corner, in block order.
struct TileOffsets {
  alignas(64) float x[kTilePixels], y[kTilePixels];
};
constexpr TileOffsets make_tile_offsets() {
  TileOffsets out{};
  for (std::uint32_t i = 0; i < kTilePixels; ++i) {
    out.x[i] = static_cast<float>(block_order_x(i)) + 0.5F;
    out.y[i] = static_cast<float>(block_order_y(i)) + 0.5F;
  }
  return out;
}
constexpr TileOffsets kTileOffsets = make_tile_offsets();

/// A Gaussian as the pixels of one tile see it.
struct TileGaussian {
  V x, y, log2_alpha, uxx, uxy, uyy;

  HWY_INLINE TileGaussian(const Splat& splat, float corner_x, float corner_y)
      : x(Splat1(splat.x - corner_x)),
        y(Splat1(splat.y - corner_y)),
        log2_alpha(Splat1(splat.log2_alpha)),
        uxx(Splat1(splat.uxx)),
        uxy(Splat1(splat.uxy)),
        uyy(Splat1(splat.uyy)) {}
};

/// Splats of a tile lie apart in memory.
constexpr std::uint32_t kPrefetchEntries = 8;

struct Footprint {
  V u, v, log2_alpha;
};
HWY_INLINE Footprint Evaluate(const TileGaussian& gaussian, std::uint32_t pixel) {
  const F f;
  const V dx = hn::Sub(hn::Load(f, kTileOffsets.x + pixel), gaussian.x);
  const V dy = hn::Sub(hn::Load(f, kTileOffsets.y + pixel), gaussian.y);
  Footprint out;
  out.u = hn::MulAdd(gaussian.uxx, dx, hn::Mul(gaussian.uxy, dy));
  out.v = hn::Mul(gaussian.uyy, dy);
  out.log2_alpha = hn::NegMulAdd(out.u, out.u, hn::NegMulAdd(out.v, out.v, gaussian.log2_alpha));
  return out;
}

}  // namespace splatbus::raster::cpu::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();
#endif
