#include "stream/value_changes.h"

#include <algorithm>
#include <cstdlib>
#include <type_traits>

#include "stream/quantized.h"

// Highway needs this order.
// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "stream/value_changes.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace splatbus::stream::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

template <class Held>
HWY_INLINE void AddChanges(const std::int32_t* target, const std::uint32_t* column, const Held* held,
                           const std::int32_t* anchor, std::size_t rows, const ValueChanges& to) {
  const hn::ScalableTag<std::int32_t> d;
  const hn::RebindToUnsigned<decltype(d)> u;
  std::size_t i = 0;
  for (; i + hn::Lanes(d) <= rows; i += hn::Lanes(d)) {
    const auto where = hn::LoadU(u, column + i);
    const auto known = hn::Ne(where, hn::Set(u, kNotHeld));
    const auto value = hn::GatherIndex(d, target, hn::BitCast(d, hn::IfThenElseZero(known, where)));
    const auto held_value = [&] {
      if constexpr (std::is_same_v<Held, std::int32_t>) {
        return hn::LoadU(d, held + i);
      } else {
        return hn::PromoteTo(d, hn::LoadU(hn::Rebind<Held, decltype(d)>(), held + i));
      }
    }();
    const auto change = hn::Abs(hn::Sub(value, held_value));
    const auto drift = hn::Abs(hn::Sub(value, hn::LoadU(d, anchor + i)));
    hn::StoreU(hn::Max(hn::LoadU(d, to.largest + i), change), d, to.largest + i);
    hn::StoreU(hn::Add(hn::LoadU(d, to.sum + i), hn::Min(change, hn::Set(d, ValueChanges::kSaturation))), d,
               to.sum + i);
    hn::StoreU(hn::Max(hn::LoadU(d, to.drift + i), drift), d, to.drift + i);
  }
  for (; i < rows; ++i) {
    if (column[i] == kNotHeld) continue;
    const std::int32_t value = target[column[i]], change = std::abs(value - held[i]);
    to.largest[i] = std::max(to.largest[i], change);
    to.sum[i] += std::min(change, ValueChanges::kSaturation);
    to.drift[i] = std::max(to.drift[i], std::abs(value - anchor[i]));
  }
}

void OfBytes(const std::int32_t* target, const std::uint32_t* column, const std::uint8_t* held,
             const std::int32_t* anchor, std::size_t rows, const ValueChanges& to) {
  AddChanges(target, column, held, anchor, rows, to);
}

void OfShorts(const std::int32_t* target, const std::uint32_t* column, const std::int16_t* held,
              const std::int32_t* anchor, std::size_t rows, const ValueChanges& to) {
  AddChanges(target, column, held, anchor, rows, to);
}

void OfInts(const std::int32_t* target, const std::uint32_t* column, const std::int32_t* held,
            const std::int32_t* anchor, std::size_t rows, const ValueChanges& to) {
  AddChanges(target, column, held, anchor, rows, to);
}

}  // namespace splatbus::stream::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace splatbus::stream {

HWY_EXPORT(OfBytes);
HWY_EXPORT(OfShorts);
HWY_EXPORT(OfInts);

void add_changes(const std::int32_t* target, const std::uint32_t* column, const std::uint8_t* held,
                 const std::int32_t* anchor, std::size_t rows, const ValueChanges& to) {
  HWY_DYNAMIC_DISPATCH(OfBytes)(target, column, held, anchor, rows, to);
}

void add_changes(const std::int32_t* target, const std::uint32_t* column, const std::int16_t* held,
                 const std::int32_t* anchor, std::size_t rows, const ValueChanges& to) {
  HWY_DYNAMIC_DISPATCH(OfShorts)(target, column, held, anchor, rows, to);
}

void add_changes(const std::int32_t* target, const std::uint32_t* column, const std::int32_t* held,
                 const std::int32_t* anchor, std::size_t rows, const ValueChanges& to) {
  HWY_DYNAMIC_DISPATCH(OfInts)(target, column, held, anchor, rows, to);
}

}  // namespace splatbus::stream
#endif
