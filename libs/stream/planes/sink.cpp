#include "stream/planes/sink.h"

#include <bit>
#include <cmath>

namespace splatbus::stream::planes {

void put_varint(Bytes& out, std::uint64_t value) {
  for (; value >= 0x80; value >>= 7U) out.push_back(static_cast<std::uint8_t>(value | 0x80U));
  out.push_back(static_cast<std::uint8_t>(value));
}

namespace {

// Memory that is given back to the system has to be asked for and cleared again.
std::vector<CodedSymbol>& emptied_symbols() {
  thread_local std::vector<CodedSymbol> symbols;
  symbols.clear();
  return symbols;
}

}  // namespace

Sink::Sink(std::size_t count, bool account)
    : count_(count), account_(account), coded_(emptied_symbols()), escaped_(count) {}

void Sink::put_waiting() {
  const std::size_t at = plain_.size();
  plain_.resize(at + 4);
  for (std::size_t byte = 0; byte < 4; ++byte) plain_[at + byte] = static_cast<std::uint8_t>(waiting_ >> (8 * byte));
  waiting_ >>= 32U;
  waiting_bits_ -= 32;
}

void Sink::residuals(const PlaneModel& model, const std::int32_t* residual, const std::uint8_t* shift) {
  const std::size_t begin = coded_.size();
  coded_.resize(begin + padded(count_));
  const std::size_t escapes = put_symbols(model, shift, residual, count_, coded_.data() + begin, escaped_.data());
  struct LowBits {
    std::int32_t half = 0;
    int width = 0;
  };
  LowBits low_bits[kMaxShift + 1];
  for (int n = 0; n <= kMaxShift; ++n) {
    const int width = spread_at(model, n).low_bits;
    low_bits[n] = {(1 << width) >> 1, width};
  }
  for (std::size_t k = 0; k < escapes; ++k) {
    const std::size_t i = escaped_[k];
    const LowBits& low = low_bits[shift[i]];
    const std::int32_t high = (residual[i] + low.half) >> low.width;
    const std::uint32_t zigzag = static_cast<std::uint32_t>(high) << 1U ^ static_cast<std::uint32_t>(high >> 31);
    const int width = static_cast<int>(std::bit_width(zigzag));
    plain(static_cast<std::uint64_t>(width), 6);
    if (width > 1) plain(zigzag & ((1U << (width - 1)) - 1), width - 1);
  }
  for (std::size_t i = 0; i < count_ && model.spread >= kSpreads; ++i) {
    const LowBits& low = low_bits[shift[i]];
    plain(static_cast<std::uint32_t>(residual[i] + low.half) & ((1U << low.width) - 1), low.width);
  }
  for (std::size_t i = 0; i < count_ && account_; ++i) {
    symbol_bits_ += kProbabilityBits - std::log2(static_cast<double>(coded_[begin + i] >> 16U));
  }
}

Bytes Sink::finish(std::uint8_t flags) {
  for (; waiting_bits_ > 0; waiting_bits_ -= 8, waiting_ >>= 8U) plain_.push_back(static_cast<std::uint8_t>(waiting_));
  const std::vector<std::uint16_t> words = words_of(coded_, count_);
  Bytes out{kFormat, flags};
  out.reserve(header.size() + 2 * words.size() + plain_.size() + 16);
  put_varint(out, header.size());
  put_varint(out, words.size());
  out.insert(out.end(), header.begin(), header.end());
  std::size_t to = out.size();
  out.resize(to + 2 * words.size());
  for (std::size_t k = words.size(); k-- > 0; to += 2) {
    out[to] = static_cast<std::uint8_t>(words[k]);
    out[to + 1] = static_cast<std::uint8_t>(words[k] >> 8U);
  }
  out.insert(out.end(), plain_.begin(), plain_.end());
  return out;
}

}  // namespace splatbus::stream::planes
