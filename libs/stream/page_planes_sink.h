#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "stream/page_planes.h"

// What the encoder of PageCodec::Planes writes to.
namespace splatbus::stream::planes {

void put_varint(Bytes& out, std::uint64_t value);

/// The three parts of a blob.
class Sink {
 public:
  /// `account`: size() is asked for.
  Sink(std::size_t count, bool account) : count_(count), account_(account) {}
  Bytes header;

  /// Up to 63 bits.
  void plain(std::uint64_t value, int bits);
  /// One plane of [count] residuals.
  void residuals(const PlaneModel& model, const std::int32_t* residual, const std::uint8_t* context,
                 const std::array<std::uint8_t, kClasses>& shift);
  /// Bytes so far, but for what coming symbols share a word with.
  [[nodiscard]] double size() const {
    return static_cast<double>(header.size() + plain_.size()) + (waiting_bits_ + symbol_bits_) / 8;
  }
  [[nodiscard]] Bytes finish(std::uint8_t flags);

 private:
  /// Last symbol first, so that a decoder has the first one first.
  [[nodiscard]] std::vector<std::uint16_t> code() const;

  std::size_t count_;
  bool account_;
  double symbol_bits_ = 0;
  std::vector<std::uint16_t> symbols_;
  Bytes plain_;
  std::uint64_t waiting_ = 0;
  int waiting_bits_ = 0;
};

}  // namespace splatbus::stream::planes
