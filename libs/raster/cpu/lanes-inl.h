// Per-target SIMD helpers; included once a Highway target by the kernels.
#if defined(SPLATBUS_RASTER_LANES_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SPLATBUS_RASTER_LANES_INL_H
#undef SPLATBUS_RASTER_LANES_INL_H
#else
#define SPLATBUS_RASTER_LANES_INL_H
#endif

#include <cstddef>
#include <cstdint>

#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace splatbus::raster::cpu::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

/// At most 16 lanes: a block of 4x4 pixels, or 16 Gaussians of neighbouring columns.
using F = hn::CappedTag<float, 16>;
using V = hn::Vec<F>;
using M = hn::Mask<F>;
using U = hn::RebindToUnsigned<F>;
using I = hn::RebindToSigned<F>;

HWY_INLINE V Splat1(float value) {
  return hn::Set(F(), value);
}
HWY_INLINE V MulScalar(V a, float s) {
  return hn::Mul(a, Splat1(s));
}
HWY_INLINE V MulAddScalar(V a, float s, V b) {
  return hn::MulAdd(a, Splat1(s), b);
}

/// The first n lanes from memory, the others 0; reads nothing beyond them.
template <class D>
HWY_INLINE hn::Vec<D> LoadFirst(D d, const hn::TFromD<D>* from, std::size_t n) {
  if (HWY_LIKELY(n >= hn::Lanes(d))) return hn::LoadU(d, from);
#if HWY_MEM_OPS_MIGHT_FAULT
  HWY_ALIGN hn::TFromD<D> lanes[hn::MaxLanes(d)] = {};
  for (std::size_t k = 0; k < n; ++k) lanes[k] = from[k];
  return hn::Load(d, lanes);
#else
  return hn::MaskedLoad(hn::FirstN(d, n), d, from);
#endif
}

template <class D>
HWY_INLINE void StoreFirst(D d, hn::Vec<D> value, hn::TFromD<D>* to, std::size_t n) {
  if (HWY_LIKELY(n >= hn::Lanes(d))) {
    hn::StoreU(value, d, to);
    return;
  }
#if HWY_MEM_OPS_MIGHT_FAULT
  HWY_ALIGN hn::TFromD<D> lanes[hn::MaxLanes(d)];
  hn::Store(value, d, lanes);
  for (std::size_t k = 0; k < n; ++k) to[k] = lanes[k];
#else
  hn::BlendedStore(value, hn::FirstN(d, n), d, to);
#endif
}

/// One bit a lane.
HWY_INLINE std::uint32_t LaneBits(M mask) {
  HWY_ALIGN std::uint8_t bytes[8] = {};
  hn::StoreMaskBits(F(), mask, bytes);
  return bytes[0] | static_cast<std::uint32_t>(bytes[1]) << 8U;
}

/// 2^x for x in [-126, 0], relative error 2e-7: round to the nearest integer by adding 1.5 * 2^23, then a minimax
/// polynomial of the remainder in [-1/2, 1/2].
HWY_INLINE V Exp2(V x) {
  const F f;
  const V magic = Splat1(12582912.0F);
  const V shifted = hn::Add(x, magic);
  const V r = hn::Sub(x, hn::Sub(shifted, magic));
  V p = Splat1(1.33336498402e-3F);
  p = hn::MulAdd(p, r, Splat1(9.61817953372e-3F));
  p = hn::MulAdd(p, r, Splat1(5.55033247283e-2F));
  p = hn::MulAdd(p, r, Splat1(2.40226507016e-1F));
  p = hn::MulAdd(p, r, Splat1(6.93147182465e-1F));
  p = hn::MulAdd(p, r, Splat1(1.0F));
  const auto exponent = hn::ShiftLeft<23>(hn::BitCast(I(), shifted));
  return hn::BitCast(f, hn::Add(hn::BitCast(I(), p), exponent));
}

/// 1 / x to float precision without a division.
HWY_INLINE V Reciprocal(V x) {
  const V r = hn::ApproximateReciprocal(x);
  return hn::Mul(r, hn::NegMulAdd(x, r, Splat1(2.0F)));
}

}  // namespace splatbus::raster::cpu::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();
#endif
