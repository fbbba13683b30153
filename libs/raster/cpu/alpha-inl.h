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

/// A tile's pixel centres in block order, pixels.
template <std::uint32_t kSide = kTileSide>
struct PixelCentres {
  alignas(64) float x[kSide * kSide], y[kSide * kSide];

  PixelCentres(std::uint32_t corner_x, std::uint32_t corner_y) {
    for (std::uint32_t i = 0; i < kSide * kSide; ++i) {
      x[i] = static_cast<float>(corner_x + block_order_x<kSide>(i)) + 0.5F;
      y[i] = static_cast<float>(corner_y + block_order_y<kSide>(i)) + 0.5F;
    }
  }
};

struct Footprint {
  V u, v, log2_alpha;
};
HWY_INLINE Footprint Evaluate(const Splat& splat, V x, V y) {
  const V dx = hn::Sub(x, Splat1(splat.x)), dy = hn::Sub(y, Splat1(splat.y));
  Footprint out;
  out.u = hn::MulAdd(Splat1(splat.uxx), dx, hn::Mul(Splat1(splat.uxy), dy));
  out.v = hn::Mul(Splat1(splat.uyy), dy);
  out.log2_alpha = hn::NegMulAdd(out.u, out.u, hn::NegMulAdd(out.v, out.v, Splat1(splat.log2_alpha)));
  return out;
}

}  // namespace splatbus::raster::cpu::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();
#endif
