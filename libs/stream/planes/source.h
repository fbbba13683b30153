#pragma once

#include <fmt/format.h>

#include <cstdint>
#include <cstring>
#include <span>
#include <vector>

#include "stream/bytes.h"
#include "stream/planes/predict.h"
#include "stream/planes/rans.h"

// What the decoder of PageCodec::Planes reads from.
namespace splatbus::stream::planes {

inline constexpr const char* kWhat = "Page";

[[noreturn]] inline void refuse(const char* why) {
  throw StreamError(fmt::format("{}: {}", kWhat, why));
}

/// The three parts of a blob. Planes have `count` values: what is read of one beyond the end is 0, and then refused.
class Source {
 public:
  Source(std::span<const std::uint8_t> bytes, std::size_t count)
      : count_(count), header_(bytes, kWhat), escaped_(count) {
    const std::uint64_t header = header_.varint();
    const std::uint64_t words = header_.varint();
    const std::size_t left = header_.left();
    if (header > left || words > (left - header) / 2 || words < 2 * kStates) refuse("parts that are longer than it is");
    const auto parts = bytes.last(left);
    header_ = ByteReader(parts.first(header), kWhat);
    words_.resize(words + count + kWordsAhead);
    std::memcpy(words_.data(), parts.data() + header, 2 * words);
    last_word_ = words_.data() + words;
    reader_.word = words_.data();
    for (std::uint32_t& state : reader_.states) {
      state = reader_.word[0] | std::uint32_t{reader_.word[1]} << 16U;
      reader_.word += 2;
      if (state >= kStateLow << 16U) refuse("an impossible first state");
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

  /// One plane's residuals into `out` [count].
  void residuals(const PlaneModel& model, const std::uint8_t* shift, std::int32_t* out) {
    const std::size_t escapes = read_symbols(reader_, model, shift, count_, out, escaped_.data());
    for (std::size_t k = 0; k < escapes; ++k) {
      const int width = static_cast<int>(plain(6));
      const std::uint32_t zigzag = width == 0 || width > 32 ? 0 : plain(width - 1) | 1U << (width - 1);
      out[escaped_[k]] = static_cast<std::int32_t>((zigzag >> 1U) ^ (0U - (zigzag & 1U)));
    }
    if (model.spread >= kSpreads) low_bits(model, shift, out);
    check();
  }

  void check() const {
    if (reader_.word > last_word_ || at_bit_ > plain_bits_) refuse("ends before its Gaussians do");
  }

  void finish() const {
    header_.finish();
    bool done = reader_.word == last_word_ && (at_bit_ + 7) / 8 == plain_bits_ / 8;
    for (const std::uint32_t state : reader_.states) done &= state == kStateLow;
    if (!done) refuse("goes on after its Gaussians");
  }

 private:
  void low_bits(const PlaneModel& model, const std::uint8_t* shift, std::int32_t* out) {
    int width[kMaxShift + 1];
    for (int n = 0; n <= kMaxShift; ++n) width[n] = spread_at(model, n).low_bits;
    for (std::size_t i = 0; i < count_; ++i) {
      const int bits = width[shift[i]];
      const std::uint32_t low = plain(bits) - ((1U << bits) >> 1U);
      out[i] = static_cast<std::int32_t>((static_cast<std::uint32_t>(out[i]) << bits) + low);
    }
  }

  std::size_t count_;
  ByteReader header_;
  WordReader reader_;
  std::vector<std::uint16_t> words_, escaped_;
  const std::uint16_t* last_word_ = nullptr;
  Bytes plain_;
  std::size_t plain_bits_ = 0, at_bit_ = 0;
};

}  // namespace splatbus::stream::planes
