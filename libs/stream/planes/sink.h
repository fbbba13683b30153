#pragma once

#include <cstdint>
#include <vector>

#include "stream/bytes.h"
#include "stream/planes/rans.h"

// What the encoder of PageCodec::Planes writes to.
namespace splatbus::stream::planes {

void put_varint(Bytes& out, std::uint64_t value);

/// The three parts of a blob.
class Sink {
 public:
  /// The only one of its thread. `account`: size() is asked for.
  Sink(std::size_t count, bool account);
  Bytes header;

  /// Up to 63 bits, none above them.
  void plain(std::uint64_t value, int bits) {
    if (bits > 32) {
      plain(value & 0xFFFFFFFFU, 32);
      return plain(value >> 32U, bits - 32);
    }
    waiting_ |= value << waiting_bits_;
    waiting_bits_ += bits;
    if (waiting_bits_ >= 32) put_waiting();
  }
  /// One plane of [count] residuals; `shift` [count].
  void residuals(const PlaneModel& model, const std::int32_t* residual, const std::uint8_t* shift);
  /// Bytes so far, but for what coming symbols share a word with.
  [[nodiscard]] double size() const {
    return static_cast<double>(header.size() + plain_.size()) + (waiting_bits_ + symbol_bits_) / 8;
  }
  [[nodiscard]] Bytes finish(std::uint8_t flags);

 private:
  void put_waiting();

  std::size_t count_;
  bool account_;
  double symbol_bits_ = 0;
  std::vector<CodedSymbol>& coded_;  ///< the thread's, which keeps its size
  std::vector<std::uint16_t> escaped_;
  Bytes plain_;
  std::uint64_t waiting_ = 0;
  int waiting_bits_ = 0;
};

}  // namespace splatbus::stream::planes
