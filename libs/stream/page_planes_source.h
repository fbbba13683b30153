#pragma once

#include <fmt/format.h>

#include <cstdint>
#include <cstring>
#include <span>
#include <vector>

#include "stream/page_planes.h"

#define SPLATBUS_INLINE __attribute__((always_inline))

// What the decoder of PageCodec::Planes reads from.
namespace splatbus::stream::planes {

inline constexpr const char* kWhat = "Page";

[[noreturn]] inline void refuse(const char* why) {
  throw StreamError(fmt::format("{}: {}", kWhat, why));
}

/// For each table and each value of a state's low bits: symbol << 22 | within the symbol << 11 | its frequency.
struct DecodingTables {
  std::vector<std::uint32_t> entries;

  DecodingTables() : entries(std::size_t{kTables} * kProbabilityOne) {
    std::size_t at = 0;
    for (const Tables::Frequencies& frequency : tables().frequency) {
      for (std::uint32_t symbol = 0; symbol < kSymbols; ++symbol) {
        for (std::uint32_t k = 0; k < frequency[symbol]; ++k) {
          entries[at++] = symbol << (2 * kProbabilityBits) | k << kProbabilityBits | frequency[symbol];
        }
      }
    }
  }
  /// Where a table begins.
  static std::uint32_t at(Shape shape, int table) {
    return static_cast<std::uint32_t>(shape == Shape::Gauss ? kSpreads + table : table) << kProbabilityBits;
  }
};

inline const DecodingTables& decoding_tables() {
  static const DecodingTables made;
  return made;
}

/// The three parts of a blob. Planes have `count` values: what is read of one beyond the end is 0, and then refused.
class Source {
 public:
  Source(std::span<const std::uint8_t> bytes, std::size_t count) : count_(count), header_(bytes, kWhat) {
    const std::uint64_t header = header_.varint();
    const std::uint64_t words = header_.varint();
    const std::size_t left = header_.left();
    if (header > left || words > (left - header) / 2 || words < 2 * kStates) refuse("parts that are longer than it is");
    const auto parts = bytes.last(left);
    header_ = ByteReader(parts.first(header), kWhat);
    words_.resize(words + count + 1);
    std::memcpy(words_.data(), parts.data() + header, 2 * words);
    last_word_ = words_.data() + words;
    next_word_ = words_.data();
    for (std::uint32_t& state : states_) {
      state = next_word_[0] | std::uint32_t{next_word_[1]} << 16U;
      next_word_ += 2;
      if (state >= kStateLow << 16U) refuse("a state that none begins with");
    }
    const auto plain = parts.subspan(header + 2 * words);
    plain_bits_ = 8 * plain.size();
    plain_.resize(plain.size() + 8 * count + 16);
    if (!plain.empty()) std::memcpy(plain_.data(), plain.data(), plain.size());
  }

  [[nodiscard]] ByteReader& header() { return header_; }
  [[nodiscard]] std::size_t count() const { return count_; }

  /// Up to 32.
  [[nodiscard]] std::uint32_t plain(int bits) {
    std::uint64_t word = 0;
    std::memcpy(&word, plain_.data() + (at_bit_ >> 3U), sizeof(word));
    word >>= at_bit_ & 7U;
    at_bit_ += static_cast<std::size_t>(bits);
    return static_cast<std::uint32_t>(word & ((std::uint64_t{1} << bits) - 1));
  }

  /// What a lane's value is read with, by its context.
  struct Contexts {
    const std::uint8_t* of_lane;
    std::uint32_t table[kClasses];   ///< where its symbols' table begins
    std::uint32_t offset[kClasses];  ///< added to what the value is predicted from
    std::uint32_t shift[kClasses];
    std::uint32_t low_bits[kClasses];
  };

  /// One plane: value i is `value(i, context, residual)`.
  template <class Value>
  void values(const Contexts& contexts, const Value& value, std::int32_t* out) {
    bool has_low_bits = false;
    for (const std::uint32_t bits : contexts.low_bits) has_low_bits |= bits != 0;
    if (has_low_bits) {
      symbols(
          contexts, [](std::size_t, std::uint8_t, std::uint32_t residual) SPLATBUS_INLINE { return residual; }, out);
      for (std::size_t i = 0; i < count_; ++i) {
        const std::uint8_t k = contexts.of_lane[i];
        const std::uint32_t bits = contexts.low_bits[k];
        const std::uint32_t low = plain(static_cast<int>(bits)) - ((1U << bits) >> 1U);
        out[i] = static_cast<std::int32_t>(value(i, k, (static_cast<std::uint32_t>(out[i]) << bits) + low));
      }
    } else {
      symbols(contexts, value, out);
    }
    check();
  }

  void check() const {
    if (next_word_ > last_word_ || at_bit_ > plain_bits_) refuse("ends before its Gaussians do");
  }

  void finish() const {
    header_.finish();
    bool done = next_word_ == last_word_ && (at_bit_ + 7) / 8 == plain_bits_ / 8;
    for (const std::uint32_t state : states_) done &= state == kStateLow;
    if (!done) refuse("goes on after its Gaussians");
  }

 private:
  template <class Value>
  void symbols(const Contexts& contexts, const Value& value, std::int32_t* out) {
    const std::uint32_t* const entries = decoding_tables().entries.data();
    const std::uint8_t* const context = contexts.of_lane;
    const std::uint16_t* word = next_word_;
    const auto one = [&](std::uint32_t& x, std::size_t i) SPLATBUS_INLINE {
      const std::uint8_t k = context[i];
      const std::uint32_t entry = entries[contexts.table[k] + (x & (kProbabilityOne - 1))];
      x = (entry & (kProbabilityOne - 1)) * (x >> kProbabilityBits) +
          (entry >> kProbabilityBits & (kProbabilityOne - 1));
      const std::uint32_t filled = x << 16U | *word;
      // Without a branch, which nobody could predict. States are below 2^31.
      const std::uint32_t fill = (x - kStateLow) >> 31U;
      word += fill;
      x ^= (x ^ filled) & (0U - fill);
      std::uint32_t zigzag = entry >> (2 * kProbabilityBits);
      if (zigzag == kEscape) [[unlikely]] {
        const int width = static_cast<int>(plain(6));
        zigzag = width == 0 || width > 32 ? 0 : plain(width - 1) | 1U << (width - 1);
      }
      out[i] = static_cast<std::int32_t>(value(i, k, (zigzag >> 1U) ^ (0U - (zigzag & 1U))));
    };
    std::uint32_t states[kStates];
    for (std::size_t k = 0; k < kStates; ++k) states[k] = states_[k];
    const std::size_t count = count_, whole = count / kStates * kStates;
    for (std::size_t i = 0; i < whole; i += kStates) {
      for (std::size_t k = 0; k < kStates; ++k) one(states[k], i + k);
    }
    for (std::size_t i = whole; i < count; ++i) one(states[i % kStates], i);
    for (std::size_t k = 0; k < kStates; ++k) states_[k] = states[k];
    next_word_ = word;
  }

  std::size_t count_;
  ByteReader header_;
  std::vector<std::uint16_t> words_;
  const std::uint16_t *next_word_ = nullptr, *last_word_ = nullptr;
  std::uint32_t states_[kStates]{};
  Bytes plain_;
  std::size_t plain_bits_ = 0, at_bit_ = 0;
};

}  // namespace splatbus::stream::planes
