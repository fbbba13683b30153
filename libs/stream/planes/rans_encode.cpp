#include <algorithm>

#include "stream/planes/rans.h"

// Highway needs this order.
// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "stream/planes/rans_encode.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
// clang-format on

#ifndef SPLATBUS_RANS_ENCODE_ONCE
#define SPLATBUS_RANS_ENCODE_ONCE

namespace splatbus::stream::planes {

/// [tables][kSymbols].
inline const CodedSymbol* coded_symbols() {
  static const std::vector<CodedSymbol> made = [] {
    std::vector<CodedSymbol> out;
    for (const Tables::Frequencies& frequency : tables().frequency) {
      const CodedSymbol escape =
          (kProbabilityOne - frequency[kEscape]) | CodedSymbol{frequency[kEscape]} << 16U | kEscapes;
      std::uint32_t start = 0;
      for (int symbol = 0; symbol < kSymbols; ++symbol) {
        const std::uint32_t f = frequency[static_cast<std::size_t>(symbol)];
        out.push_back(f == 0 || symbol == kEscape ? escape : start | f << 16U);
        start += f;
      }
    }
    return out;
  }();
  return made.data();
}

inline const CodedSymbol* symbols_of(const PlaneModel& model) {
  return coded_symbols() + (model.shape == Shape::Gauss ? kSpreads * kSymbols : 0);
}

/// Lanes from `begin` on, one by one. Adds to `escapes`.
inline void put_lanes(const PlaneModel& model, const std::uint8_t* shift, const std::int32_t* residual,
                      std::size_t begin, std::size_t end, CodedSymbol* coded, std::uint16_t* escaped,
                      std::size_t& escapes) {
  const CodedSymbol* const symbols = symbols_of(model);
  for (std::size_t i = begin; i < end; ++i) {
    const Spread spread = spread_at(model, shift[i]);
    const std::int32_t high = (residual[i] + ((1 << spread.low_bits) >> 1)) >> spread.low_bits;
    const std::uint32_t zigzag = static_cast<std::uint32_t>(high) << 1U ^ static_cast<std::uint32_t>(high >> 31);
    const CodedSymbol symbol =
        symbols[spread.table * kSymbols + static_cast<int>(std::min(zigzag, std::uint32_t{kEscape}))];
    coded[i] = symbol & ~kEscapes;
    escaped[escapes] = static_cast<std::uint16_t>(i);
    escapes += (symbol & kEscapes) != 0 ? 1 : 0;
  }
}

/// Takes the symbol in; a word that it gives away goes to `to`.
inline std::uint32_t state_with(std::uint32_t x, CodedSymbol symbol, std::uint16_t*& to) {
  const std::uint32_t frequency = symbol >> 16U, start = symbol & 0xFFFFU;
  *to = static_cast<std::uint16_t>(x);
  const std::uint32_t full = x >= frequency << (31 - kProbabilityBits) ? 1 : 0;
  to += full;
  x >>= 16U * full;
  const std::uint32_t quotient = x / frequency;
  return (quotient << kProbabilityBits) + start + (x - quotient * frequency);
}

}  // namespace splatbus::stream::planes

#endif

HWY_BEFORE_NAMESPACE();
namespace splatbus::stream::planes::HWY_NAMESPACE {

#if HWY_MAX_BYTES >= 32

namespace hn = hwy::HWY_NAMESPACE;

using D = hn::CappedTag<std::uint32_t, kStates>;
using I = hn::RebindToSigned<D>;
using F = hn::RebindToFloat<D>;
using V = hn::Vec<D>;
constexpr std::size_t kLanes = hn::MaxLanes(D());
constexpr std::size_t kVectors = kStates / kLanes;

std::size_t PutSymbols(const PlaneModel& model, const std::uint8_t* shift, const std::int32_t* residual,
                       std::size_t count, CodedSymbol* coded, std::uint16_t* escaped) {
  const D d;
  const I i32;
  const CodedSymbol* const symbols = symbols_of(model);
  const auto spread = hn::Set(i32, model.spread), slope = hn::Set(i32, model.slope), zero = hn::Zero(i32);
  std::size_t escapes = 0, i = 0;
  for (; i + kLanes <= count; i += kLanes) {
    const auto n = hn::PromoteTo(i32, hn::LoadU(hn::Rebind<std::uint8_t, I>(), shift + i));
    auto table = hn::Max(hn::Sub(spread, hn::Mul(slope, n)), zero);
    const auto low_bits = hn::ShiftRight<2>(hn::Max(hn::Sub(table, hn::Set(i32, kSpreads - 4)), zero));
    table = hn::Sub(table, hn::ShiftLeft<2>(low_bits));
    const auto half = hn::ShiftRight<1>(hn::Shl(hn::Set(i32, 1), low_bits));
    const auto high = hn::Shr(hn::Add(hn::LoadU(i32, residual + i), half), low_bits);
    const V zigzag = hn::BitCast(d, hn::Xor(hn::ShiftLeft<1>(high), hn::ShiftRight<31>(high)));
    const V symbol = hn::Min(zigzag, hn::Set(d, std::uint32_t{kEscape}));
    const auto index = hn::Add(hn::ShiftLeft<6>(table), hn::BitCast(i32, symbol));
    const V entry = hn::GatherIndex(d, symbols, index);
    hn::StoreU(hn::AndNot(hn::Set(d, kEscapes), entry), d, coded + i);
    if (HWY_UNLIKELY(!hn::AllFalse(d, hn::TestBit(entry, hn::Set(d, kEscapes))))) {
      std::uint32_t entries[kLanes];
      hn::StoreU(entry, d, entries);
      for (std::size_t k = 0; k < kLanes; ++k) {
        escaped[escapes] = static_cast<std::uint16_t>(i + k);
        escapes += (entries[k] & kEscapes) != 0 ? 1 : 0;
      }
    }
  }
  put_lanes(model, shift, residual, i, count, coded, escaped, escapes);
  return escapes;
}

std::uint16_t* PutWords(const CodedSymbol* plane, std::size_t count, std::uint32_t* states, std::uint16_t* to) {
  const D d;
  const I i32;
  const F f32;
  std::size_t end = count;
  while (end % kStates != 0) {
    --end;
    states[end % kStates] = state_with(states[end % kStates], plane[end], to);
  }
  // The last lane first.
  V x[kVectors];
  for (std::size_t v = 0; v < kVectors; ++v) x[v] = hn::Reverse(d, hn::LoadU(d, states + kStates - (v + 1) * kLanes));
  for (; end > 0; end -= kStates) {
    for (std::size_t v = 0; v < kVectors; ++v) {
      const V symbol = hn::Reverse(d, hn::LoadU(d, plane + end - (v + 1) * kLanes));
      const auto frequency = hn::BitCast(i32, hn::ShiftRight<16>(symbol));
      const V start = hn::And(symbol, hn::Set(d, 0xFFFFU));
      const auto full =
          hn::RebindMask(d, hn::Not(hn::Lt(hn::BitCast(i32, x[v]), hn::ShiftLeft<31 - kProbabilityBits>(frequency))));
      const V words = hn::Compress(hn::And(x[v], hn::Set(d, 0xFFFFU)), full);
      hn::StoreU(hn::DemoteTo(hn::Rebind<std::uint16_t, D>(), hn::BitCast(i32, words)), hn::Rebind<std::uint16_t, D>(),
                 to);
      to += hn::CountTrue(d, full);
      const auto kept = hn::BitCast(i32, hn::IfThenElse(full, hn::ShiftRight<16>(x[v]), x[v]));
      // As a float the quotient, below 2^20, is off by less than one.
      const auto inverse = hn::Div(hn::Set(f32, 1.0F), hn::ConvertTo(f32, frequency));
      auto quotient = hn::ConvertTo(i32, hn::Mul(hn::ConvertTo(f32, kept), inverse));
      auto rest = hn::Sub(kept, hn::Mul(quotient, frequency));
      const auto above = hn::Lt(rest, hn::Zero(i32));
      quotient = hn::IfThenElse(above, hn::Sub(quotient, hn::Set(i32, 1)), quotient);
      rest = hn::IfThenElse(above, hn::Add(rest, frequency), rest);
      const auto below = hn::Not(hn::Lt(rest, frequency));
      quotient = hn::IfThenElse(below, hn::Add(quotient, hn::Set(i32, 1)), quotient);
      rest = hn::IfThenElse(below, hn::Sub(rest, frequency), rest);
      x[v] = hn::Add(hn::Add(hn::BitCast(d, hn::ShiftLeft<kProbabilityBits>(quotient)), start), hn::BitCast(d, rest));
    }
  }
  for (std::size_t v = 0; v < kVectors; ++v) hn::StoreU(hn::Reverse(d, x[v]), d, states + kStates - (v + 1) * kLanes);
  return to;
}

#else  // where vectors are too short to pay

std::size_t PutSymbols(const PlaneModel& model, const std::uint8_t* shift, const std::int32_t* residual,
                       std::size_t count, CodedSymbol* coded, std::uint16_t* escaped) {
  std::size_t escapes = 0;
  put_lanes(model, shift, residual, 0, count, coded, escaped, escapes);
  return escapes;
}

std::uint16_t* PutWords(const CodedSymbol* plane, std::size_t count, std::uint32_t* states, std::uint16_t* to) {
  for (std::size_t i = count; i-- > 0;) states[i % kStates] = state_with(states[i % kStates], plane[i], to);
  return to;
}

#endif

}  // namespace splatbus::stream::planes::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace splatbus::stream::planes {

HWY_EXPORT(PutSymbols);
HWY_EXPORT(PutWords);

std::size_t put_symbols(const PlaneModel& model, const std::uint8_t* shift, const std::int32_t* residual,
                        std::size_t count, CodedSymbol* coded, std::uint16_t* escaped) {
  return HWY_DYNAMIC_DISPATCH(PutSymbols)(model, shift, residual, count, coded, escaped);
}

std::vector<std::uint16_t> words_of(const std::vector<CodedSymbol>& coded, std::size_t count) {
  std::vector<std::uint16_t> words(coded.size() + 3 * kStates);
  std::uint32_t states[kStates];
  std::fill_n(states, kStates, kStateLow);
  std::uint16_t* to = words.data();
  for (std::size_t end = coded.size(); end > 0; end -= padded(count)) {
    to = HWY_DYNAMIC_DISPATCH(PutWords)(coded.data() + end - padded(count), count, states, to);
  }
  for (std::size_t k = kStates; k-- > 0;) {
    *to++ = static_cast<std::uint16_t>(states[k] >> 16U);
    *to++ = static_cast<std::uint16_t>(states[k]);
  }
  words.resize(static_cast<std::size_t>(to - words.data()));
  return words;
}

}  // namespace splatbus::stream::planes
#endif
