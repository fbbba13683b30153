#include "stream/planes/rans.h"

// Highway needs this order.
// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "stream/planes/rans_decode.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
// clang-format on

#ifndef SPLATBUS_RANS_DECODE_ONCE
#define SPLATBUS_RANS_DECODE_ONCE

namespace splatbus::stream::planes {

/// For each table and each value of a state's low bits: symbol, place within the symbol, frequency, in kProbabilityBits
/// each but for the symbol.
inline const std::uint32_t* decoding_entries() {
  static const std::vector<std::uint32_t> made = [] {
    std::vector<std::uint32_t> entries;
    entries.reserve(std::size_t{kTables} * kProbabilityOne);
    for (const Tables::Frequencies& frequency : tables().frequency) {
      for (std::uint32_t symbol = 0; symbol < kSymbols; ++symbol) {
        for (std::uint32_t k = 0; k < frequency[symbol]; ++k) {
          entries.push_back(symbol << (2 * kProbabilityBits) | k << kProbabilityBits | frequency[symbol]);
        }
      }
    }
    return entries;
  }();
  return made.data();
}

/// Of a state that has given an entry's symbol away.
inline std::uint32_t state_after(std::uint32_t x, std::uint32_t entry) {
  return (entry & (kProbabilityOne - 1)) * (x >> kProbabilityBits) +
         (entry >> kProbabilityBits & (kProbabilityOne - 1));
}

/// Where in all tables those of a shape begin.
inline std::uint32_t first_entry(const PlaneModel& model) {
  return (model.shape == Shape::Gauss ? std::uint32_t{kSpreads} : 0U) << kProbabilityBits;
}

/// Lanes from `begin` on, one by one. Adds to `escapes`.
inline void read_lanes(WordReader& reader, const PlaneModel& model, const std::uint8_t* shift, std::size_t begin,
                       std::size_t end, std::int32_t* out, std::uint16_t* escaped, std::size_t& escapes) {
  const std::uint32_t* const entries = decoding_entries() + first_entry(model);
  std::uint32_t table[kMaxShift + 1];
  for (int n = 0; n <= kMaxShift; ++n)
    table[n] = static_cast<std::uint32_t>(spread_at(model, n).table) << kProbabilityBits;
  const std::uint16_t* word = reader.word;
  for (std::size_t i = begin; i < end; ++i) {
    std::uint32_t& state = reader.states[i % kStates];
    const std::uint32_t entry = entries[table[shift[i]] + (state & (kProbabilityOne - 1))];
    std::uint32_t x = state_after(state, entry);
    const std::uint32_t filled = x << 16U | *word;
    // Without a branch, which nobody could predict. States are below 2^31.
    const std::uint32_t fill = (x - kStateLow) >> 31U;
    word += fill;
    x ^= (x ^ filled) & (0U - fill);
    state = x;
    const std::uint32_t zigzag = entry >> (2 * kProbabilityBits);
    escaped[escapes] = static_cast<std::uint16_t>(i);
    escapes += zigzag == kEscape ? 1 : 0;
    out[i] = static_cast<std::int32_t>((zigzag >> 1U) ^ (0U - (zigzag & 1U)));
  }
  reader.word = word;
}

/// For each mask of eight lanes: how many of the lanes below are in it.
inline const std::uint8_t* lanes_below() {
  static const std::vector<std::uint8_t> made = [] {
    std::vector<std::uint8_t> below;
    for (unsigned mask = 0; mask < 256; ++mask) {
      for (unsigned lane = 0, sum = 0; lane < 8; sum += mask >> lane++ & 1U) {
        below.push_back(static_cast<std::uint8_t>(sum));
      }
    }
    return below;
  }();
  return made.data();
}

}  // namespace splatbus::stream::planes

#endif

HWY_BEFORE_NAMESPACE();
namespace splatbus::stream::planes::HWY_NAMESPACE {

#if HWY_MAX_BYTES >= 32

namespace hn = hwy::HWY_NAMESPACE;

// Two short chains of gathers overlap where one long one waits.
using D = hn::CappedTag<std::uint32_t, 8>;
using I = hn::RebindToSigned<D>;
using V = hn::Vec<D>;

/// The next words, to the lanes of `mask` in turn.
HWY_INLINE V Expanded(hn::Mask<D> mask, const std::uint16_t* word) {
  const D d;
  const V next = hn::PromoteTo(d, hn::LoadU(hn::Rebind<std::uint16_t, D>(), word));
#if HWY_TARGET <= HWY_AVX3
  return V{_mm256_maskz_expand_epi32(mask.raw, next.raw)};
#else
  static_assert(hn::MaxLanes(D()) == 8);
  std::uint8_t bits[8];
  (void)hn::StoreMaskBits(d, mask, bits);
  const hn::Rebind<std::uint8_t, D> bytes;
  const V from = hn::PromoteTo(d, hn::LoadU(bytes, lanes_below() + 8 * std::size_t{bits[0]}));
  return hn::TableLookupLanes(next, hn::IndicesFromVec(d, from));
#endif
}

std::size_t ReadSymbols(WordReader& reader, const PlaneModel& model, const std::uint8_t* shift, std::size_t count,
                        std::int32_t* out, std::uint16_t* escaped) {
  const D d;
  const I i32;
  constexpr std::size_t kLanes = hn::MaxLanes(D());
  constexpr std::size_t kVectors = kStates / kLanes;
  const auto* const entries = reinterpret_cast<const std::uint32_t*>(decoding_entries()) + first_entry(model);
  const auto spread = hn::Set(i32, model.spread), slope = hn::Set(i32, model.slope);
  const V low_mask = hn::Set(d, kProbabilityOne - 1);
  const auto state_low = hn::Set(i32, static_cast<std::int32_t>(kStateLow));
  V states[kVectors];
  for (std::size_t v = 0; v < kVectors; ++v) states[v] = hn::LoadU(d, reader.states.data() + v * kLanes);
  const std::uint16_t* word = reader.word;
  std::size_t escapes = 0;
  const std::size_t whole = count / kStates * kStates;
  for (std::size_t i = 0; i < whole; i += kStates) {
    for (std::size_t v = 0; v < kVectors; ++v) {
      const std::size_t at = i + v * kLanes;
      const auto n = hn::PromoteTo(i32, hn::LoadU(hn::Rebind<std::uint8_t, I>(), shift + at));
      auto table = hn::Max(hn::Sub(spread, hn::Mul(slope, n)), hn::Zero(i32));
      const auto wide = hn::Max(hn::Sub(table, hn::Set(i32, kSpreads - 4)), hn::Zero(i32));
      table = hn::Sub(table, hn::AndNot(hn::Set(i32, 3), wide));  // four a low bit
      const V x = states[v];
      const V slot = hn::Add(hn::BitCast(d, hn::ShiftLeft<kProbabilityBits>(table)), hn::And(x, low_mask));
      const V entry = hn::GatherIndex(d, entries, hn::BitCast(i32, slot));
      const V after = hn::Add(hn::Mul(hn::And(entry, low_mask), hn::ShiftRight<kProbabilityBits>(x)),
                              hn::And(hn::ShiftRight<kProbabilityBits>(entry), low_mask));
      const auto fill = hn::RebindMask(d, hn::Lt(hn::BitCast(i32, after), state_low));
      states[v] = hn::IfThenElse(fill, hn::Or(hn::ShiftLeft<16>(after), Expanded(fill, word)), after);
      word += hn::CountTrue(d, fill);
      const V zigzag = hn::ShiftRight<2 * kProbabilityBits>(entry);
      const V sign = hn::Sub(hn::Zero(d), hn::And(zigzag, hn::Set(d, 1U)));
      hn::StoreU(hn::BitCast(i32, hn::Xor(hn::ShiftRight<1>(zigzag), sign)), i32, out + at);
      const auto escape = hn::Eq(zigzag, hn::Set(d, std::uint32_t{kEscape}));
      if (HWY_UNLIKELY(!hn::AllFalse(d, escape))) {
        std::uint32_t symbols[kLanes];
        hn::StoreU(zigzag, d, symbols);
        for (std::size_t k = 0; k < kLanes; ++k) {
          escaped[escapes] = static_cast<std::uint16_t>(at + k);
          escapes += symbols[k] == kEscape ? 1 : 0;
        }
      }
    }
  }
  for (std::size_t v = 0; v < kVectors; ++v) hn::StoreU(states[v], d, reader.states.data() + v * kLanes);
  reader.word = word;
  if (whole < count) read_lanes(reader, model, shift, whole, count, out, escaped, escapes);
  return escapes;
}

#else  // where vectors are too short to pay

std::size_t ReadSymbols(WordReader& reader, const PlaneModel& model, const std::uint8_t* shift, std::size_t count,
                        std::int32_t* out, std::uint16_t* escaped) {
  std::size_t escapes = 0;
  read_lanes(reader, model, shift, 0, count, out, escaped, escapes);
  return escapes;
}

#endif

}  // namespace splatbus::stream::planes::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace splatbus::stream::planes {

HWY_EXPORT(ReadSymbols);

std::size_t read_symbols(WordReader& reader, const PlaneModel& model, const std::uint8_t* shift, std::size_t count,
                         std::int32_t* out, std::uint16_t* escaped) {
  return HWY_DYNAMIC_DISPATCH(ReadSymbols)(reader, model, shift, count, out, escaped);
}

}  // namespace splatbus::stream::planes
#endif
