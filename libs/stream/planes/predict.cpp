#include "stream/planes/predict.h"

#include <algorithm>

#include "stream/planes/shifts.h"

// Highway needs this order.
// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "stream/planes/predict.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace splatbus::stream::planes::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

using I = hn::ScalableTag<std::int32_t>;
using V = hn::Vec<I>;
using D = hn::RebindToUnsigned<I>;

/// Unsigned arithmetic wraps; of a lane on its own.
HWY_INLINE std::uint32_t U(std::int32_t x) {
  return static_cast<std::uint32_t>(x);
}

HWY_INLINE std::int32_t OffsetOf(const PlaneModel& model, const Lanes& lanes, std::size_t i) {
  return model.offset + model.per_class * (lanes.context[i] - kClassBias) / 8;
}

/// What is predicted, rounded to the lane's shift: base and offset.
HWY_INLINE std::int32_t Rounded(std::uint32_t base, std::int32_t offset, int shift) {
  return static_cast<std::int32_t>(base + U(offset) + ((1U << shift) >> 1U)) >> shift;
}

HWY_INLINE V Shifts(const Lanes& lanes, std::size_t i) {
  return hn::PromoteTo(I(), hn::LoadU(hn::Rebind<std::uint8_t, I>(), lanes.shift + i));
}

HWY_INLINE V RoundedLanes(const PlaneModel& model, const Lanes& lanes, V base, V shift, std::size_t i) {
  const I d;
  V sum = hn::Add(base, hn::Set(d, model.offset));
  if (model.per_class != 0) {
    const V klass =
        hn::Sub(hn::PromoteTo(d, hn::LoadU(hn::Rebind<std::uint8_t, I>(), lanes.context + i)), hn::Set(d, kClassBias));
    const V eighths = hn::Mul(klass, hn::Set(d, model.per_class));
    // Towards 0.
    const V toward = hn::And(hn::ShiftRight<31>(eighths), hn::Set(d, 7));
    sum = hn::Add(sum, hn::ShiftRight<3>(hn::Add(eighths, toward)));
  }
  return hn::Shr(hn::Add(sum, hn::ShiftRight<1>(hn::Shl(hn::Set(d, 1), shift))), shift);
}

/// What the predictor looks at but for the offset; `plane`: what it is of.
template <Predictor kPredictor>
HWY_INLINE V BaseLanes(const Before& before, const std::int32_t* plane, std::size_t i) {
  const I d;
  if constexpr (kPredictor == Predictor::Lane) return hn::LoadU(d, plane + i - 1);
  if constexpr (kPredictor == Predictor::Channel) {
    return hn::ShiftRight<1>(hn::Add(hn::LoadU(d, before.last + i), hn::LoadU(d, before.colour + i)));
  }
  if constexpr (kPredictor == Predictor::Both) {
    return hn::Sub(hn::Add(hn::LoadU(d, plane + i - 1), hn::LoadU(d, before.last + i)),
                   hn::LoadU(d, before.last + i - 1));
  }
  return hn::Zero(d);
}

/// The same of one lane that is not the first.
template <Predictor kPredictor>
HWY_INLINE std::uint32_t Base(const Before& before, const std::int32_t* plane, std::ptrdiff_t i) {
  if constexpr (kPredictor == Predictor::Lane) return U(plane[i - 1]);
  if constexpr (kPredictor == Predictor::Channel) {
    return U(static_cast<std::int32_t>(U(before.last[i]) + U(before.colour[i])) >> 1);
  }
  if constexpr (kPredictor == Predictor::Both) return U(plane[i - 1]) + U(before.last[i]) - U(before.last[i - 1]);
  return 0;
}

template <Predictor kPredictor>
HWY_INLINE std::int32_t Value(const PlaneModel& model, const Lanes& lanes, std::uint32_t base, std::size_t i,
                              std::int32_t residual) {
  const int shift = lanes.shift[i];
  return static_cast<std::int32_t>((U(residual) + U(Rounded(base, OffsetOf(model, lanes, i), shift))) << shift);
}

template <Predictor kPredictor>
void ToValues(const PlaneModel& model, const Lanes& lanes, const Before& before, std::size_t count,
              std::int32_t* plane) {
  const I d;
  std::size_t i = 0;
  if constexpr (kPredictor == Predictor::Lane || kPredictor == Predictor::Both) {
    const std::uint32_t first = kPredictor == Predictor::Both ? U(before.last[0]) : 0;
    plane[0] = Value<kPredictor>(model, lanes, first, 0, plane[0]);
    i = 1;  // each from the one before
  } else {
    for (; i + hn::Lanes(d) <= count; i += hn::Lanes(d)) {
      const V shift = Shifts(lanes, i);
      const V predicted = RoundedLanes(model, lanes, BaseLanes<kPredictor>(before, plane, i), shift, i);
      hn::StoreU(hn::Shl(hn::Add(hn::LoadU(d, plane + i), predicted), shift), d, plane + i);
    }
  }
  for (; i < count; ++i) {
    const std::uint32_t base = Base<kPredictor>(before, plane, static_cast<std::ptrdiff_t>(i));
    plane[i] = Value<kPredictor>(model, lanes, base, i, plane[i]);
  }
}

template <Predictor kPredictor>
void ToResiduals(const PlaneModel& model, const Lanes& lanes, const Before& before, const std::int32_t* plane,
                 std::size_t begin, std::size_t end, std::int32_t* residual) {
  const I d;
  std::size_t i = begin;
  for (; i + hn::Lanes(d) <= end; i += hn::Lanes(d)) {
    const V shift = Shifts(lanes, i);
    const V predicted = RoundedLanes(model, lanes, BaseLanes<kPredictor>(before, plane, i), shift, i);
    hn::StoreU(hn::Sub(hn::Shr(hn::LoadU(d, plane + i), shift), predicted), d, residual + (i - begin));
  }
  for (; i < end; ++i) {
    const std::uint32_t base = Base<kPredictor>(before, plane, static_cast<std::ptrdiff_t>(i));
    const int shift = lanes.shift[i];
    residual[i - begin] = (plane[i] >> shift) - Rounded(base, OffsetOf(model, lanes, i), shift);
  }
}

void ResidualsToValues(const PlaneModel& model, const Lanes& lanes, const Before& before, std::size_t count,
                       std::int32_t* plane) {
  switch (model.predictor) {
    case Predictor::Constant:
    case Predictor::Offset:
      return ToValues<Predictor::Offset>(model, lanes, before, count, plane);
    case Predictor::Lane:
      return ToValues<Predictor::Lane>(model, lanes, before, count, plane);
    case Predictor::Channel:
      return ToValues<Predictor::Channel>(model, lanes, before, count, plane);
    case Predictor::Both:
      return ToValues<Predictor::Both>(model, lanes, before, count, plane);
  }
}

void ValuesToResiduals(const PlaneModel& model, const Lanes& lanes, const Before& before, const std::int32_t* plane,
                       std::size_t begin, std::size_t end, std::int32_t* residual) {
  switch (model.predictor) {
    case Predictor::Constant:
    case Predictor::Offset:
      return ToResiduals<Predictor::Offset>(model, lanes, before, plane, begin, end, residual);
    case Predictor::Lane:
      return ToResiduals<Predictor::Lane>(model, lanes, before, plane, begin, end, residual);
    case Predictor::Channel:
      return ToResiduals<Predictor::Channel>(model, lanes, before, plane, begin, end, residual);
    case Predictor::Both:
      return ToResiduals<Predictor::Both>(model, lanes, before, plane, begin, end, residual);
  }
}

std::pair<std::int32_t, std::int32_t> RangeOf(const std::int32_t* plane, std::size_t count) {
  const I d;
  V low = hn::Set(d, plane[0]), high = low;
  std::size_t i = 0;
  for (; i + hn::Lanes(d) <= count; i += hn::Lanes(d)) {
    const V values = hn::LoadU(d, plane + i);
    low = hn::Min(low, values);
    high = hn::Max(high, values);
  }
  std::int32_t least = hn::GetLane(hn::MinOfLanes(d, low)), largest = hn::GetLane(hn::MaxOfLanes(d, high));
  for (; i < count; ++i) {
    least = std::min(least, plane[i]);
    largest = std::max(largest, plane[i]);
  }
  return {least, largest};
}

}  // namespace splatbus::stream::planes::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace splatbus::stream::planes {

HWY_EXPORT(ResidualsToValues);
HWY_EXPORT(ValuesToResiduals);
HWY_EXPORT(RangeOf);

void residuals_to_values(const PlaneModel& model, const Lanes& lanes, const Before& before, std::size_t count,
                         std::int32_t* plane) {
  HWY_DYNAMIC_DISPATCH(ResidualsToValues)(model, lanes, before, count, plane);
}

void values_to_residuals(const PlaneModel& model, const Lanes& lanes, const Before& before, const std::int32_t* plane,
                         std::size_t begin, std::size_t end, std::int32_t* residual) {
  HWY_DYNAMIC_DISPATCH(ValuesToResiduals)(model, lanes, before, plane, begin, end, residual);
}

std::pair<std::int32_t, std::int32_t> range_of(const std::int32_t* plane, std::size_t count) {
  return HWY_DYNAMIC_DISPATCH(RangeOf)(plane, count);
}

}  // namespace splatbus::stream::planes
#endif
