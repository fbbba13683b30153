#include "stream/page_planes_sink.h"

#include <algorithm>
#include <bit>
#include <cmath>

namespace splatbus::stream::planes {

namespace {

/// How a state takes a symbol in: division by its frequency as a multiplication (Giesen 2014, ryg_rans).
struct CodedSymbol {
  std::uint32_t limit = 0, reciprocal = 0, bias = 0, complement = 0, shift = 0;
  bool escapes = true;
  float bits = 0;

  CodedSymbol() = default;
  CodedSymbol(std::uint32_t start, std::uint32_t frequency)
      : limit(frequency << (31 - kProbabilityBits)),
        bias(start),
        complement(kProbabilityOne - frequency),
        escapes(frequency == 0),
        bits(static_cast<float>(kProbabilityBits) - std::log2(static_cast<float>(std::max(frequency, 1U)))) {
    if (frequency < 2) {
      reciprocal = ~0U;
      bias += kProbabilityOne - 1;
      return;
    }
    while (frequency > (1U << shift)) ++shift;
    reciprocal = static_cast<std::uint32_t>(((std::uint64_t{1} << (shift + 31)) + frequency - 1) / frequency);
    --shift;
  }
};

const std::vector<CodedSymbol>& coded_symbols() {
  static const std::vector<CodedSymbol> made = [] {
    std::vector<CodedSymbol> out;
    for (const Tables::Frequencies& frequency : tables().frequency) {
      std::uint32_t start = 0;
      for (const std::uint16_t f : frequency) {
        out.emplace_back(start, f);
        start += f;
      }
    }
    return out;
  }();
  return made;
}

}  // namespace

void put_varint(Bytes& out, std::uint64_t value) {
  for (; value >= 0x80; value >>= 7U) out.push_back(static_cast<std::uint8_t>(value | 0x80U));
  out.push_back(static_cast<std::uint8_t>(value));
}

void Sink::plain(std::uint64_t value, int bits) {
  for (; bits > 32; bits -= 32, value >>= 32U) plain(value & 0xFFFFFFFFU, 32);
  waiting_ |= value << waiting_bits_;
  waiting_bits_ += bits;
  if (waiting_bits_ < 32) return;
  const auto whole = static_cast<std::uint32_t>(waiting_);
  for (const unsigned shift : {0U, 8U, 16U, 24U}) plain_.push_back(static_cast<std::uint8_t>(whole >> shift));
  waiting_ >>= 32U;
  waiting_bits_ -= 32;
}

void Sink::residuals(const PlaneModel& model, const std::int32_t* residual, const std::uint8_t* context,
                     const std::array<std::uint8_t, kClasses>& shift) {
  struct Code {
    std::uint32_t table = 0, half = 0, low_bits = 0;
  };
  std::array<Code, kClasses> codes;
  const int first = model.shape == Shape::Gauss ? kSpreads : 0;
  bool has_low_bits = false;
  for (std::size_t k = 0; k < kClasses; ++k) {
    const Spread spread = spread_of(model.spread - model.slope * shift[k]);
    codes[k] = {static_cast<std::uint32_t>(first + spread.table) * kSymbols, (1U << spread.low_bits) >> 1U,
                static_cast<std::uint32_t>(spread.low_bits)};
    has_low_bits |= spread.low_bits != 0;
  }
  const CodedSymbol* const coded = coded_symbols().data();
  const std::size_t begin = symbols_.size();
  symbols_.resize(begin + count_);
  std::uint16_t* const to = symbols_.data() + begin;
  for (std::size_t i = 0; i < count_; ++i) {
    const Code& code = codes[context[i]];
    const std::int32_t high = (residual[i] + static_cast<std::int32_t>(code.half)) >> code.low_bits;
    const auto mapped = static_cast<std::uint32_t>(high) << 1U ^ static_cast<std::uint32_t>(high >> 31);
    std::uint32_t symbol = code.table + std::min(mapped, std::uint32_t{kEscape});
    if (coded[symbol].escapes || mapped >= kEscape) [[unlikely]] {
      symbol = code.table + kEscape;
      const int width = std::bit_width(mapped);
      plain(static_cast<std::uint64_t>(width), 6);
      if (width > 1) plain(mapped & ((1U << (width - 1)) - 1), width - 1);
    }
    to[i] = static_cast<std::uint16_t>(symbol);
  }
  for (std::size_t i = 0; i < count_ && has_low_bits; ++i) {
    const Code& code = codes[context[i]];
    plain((static_cast<std::uint32_t>(residual[i]) + code.half) & ((1U << code.low_bits) - 1),
          static_cast<int>(code.low_bits));
  }
  for (std::size_t i = 0; i < count_ && account_; ++i) symbol_bits_ += coded[to[i]].bits;
}

Bytes Sink::finish(std::uint8_t flags) {
  for (; waiting_bits_ > 0; waiting_bits_ -= 8, waiting_ >>= 8U) plain_.push_back(static_cast<std::uint8_t>(waiting_));
  const std::vector<std::uint16_t> words = code();
  Bytes out{kFormat, flags};
  put_varint(out, header.size());
  put_varint(out, words.size());
  out.insert(out.end(), header.begin(), header.end());
  for (const std::uint16_t word : words) {
    out.push_back(static_cast<std::uint8_t>(word));
    out.push_back(static_cast<std::uint8_t>(word >> 8U));
  }
  out.insert(out.end(), plain_.begin(), plain_.end());
  return out;
}

std::vector<std::uint16_t> Sink::code() const {
  const CodedSymbol* const coded = coded_symbols().data();
  std::vector<std::uint16_t> words(symbols_.size() + 2 * kStates + 1);
  std::size_t to = words.size();
  std::uint32_t states[kStates];
  std::fill_n(states, kStates, kStateLow);
  for (std::size_t end = symbols_.size(); end > 0; end -= count_) {
    const std::uint16_t* const plane = symbols_.data() + (end - count_);
    const auto one = [&](std::size_t i) {
      const CodedSymbol& symbol = coded[plane[i]];
      std::uint32_t x = states[i % kStates];
      // Without a branch, which nobody could predict.
      words[to - 1] = static_cast<std::uint16_t>(x);
      const std::uint32_t full = x >= symbol.limit ? 1 : 0;
      to -= full;
      x >>= 16U * full;
      const auto quotient = static_cast<std::uint32_t>((std::uint64_t{x} * symbol.reciprocal) >> 32U) >> symbol.shift;
      states[i % kStates] = x + symbol.bias + quotient * symbol.complement;
    };
    std::size_t i = count_;
    while (i % kStates != 0) one(--i);
    for (; i > 0; i -= kStates) {
      for (std::size_t k = 1; k <= kStates; ++k) one(i - k);
    }
  }
  for (int k = kStates; k-- > 0;) {
    words[--to] = static_cast<std::uint16_t>(states[k] >> 16U);
    words[--to] = static_cast<std::uint16_t>(states[k]);
  }
  words.erase(words.begin(), words.begin() + static_cast<std::ptrdiff_t>(to));
  return words;
}

}  // namespace splatbus::stream::planes
