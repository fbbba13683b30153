#pragma once

#include <cassert>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "stream/layout.h"
#include "stream/quantized.h"

namespace splatbus::stream {

/// Rows are added so many at a time, and lie where they are from then on: nothing is copied to grow.
inline constexpr std::size_t kChunkRows = 4096;

/// An id for each row. Where all rows of a chunk are 0 it takes no memory.
template <class T>
class SparseRows {
 public:
  void grow() { chunks_.emplace_back(); }
  [[nodiscard]] T operator[](std::size_t row) const {
    const auto& chunk = chunks_[row / kChunkRows];
    return chunk.empty() ? T{0} : chunk[row % kChunkRows];
  }
  void set(std::size_t row, T value) {
    auto& chunk = chunks_[row / kChunkRows];
    if (chunk.empty() && value == 0) return;
    if (chunk.empty()) chunk.resize(kChunkRows);
    chunk[row % kChunkRows] = value;
  }
  [[nodiscard]] std::size_t rows() const { return chunks_.size() * kChunkRows; }
  [[nodiscard]] std::size_t bytes() const {
    std::size_t bytes = 0;
    for (const auto& chunk : chunks_) bytes += sizeof(chunk) + chunk.size() * sizeof(T);
    return bytes;
  }
  bool operator==(const SparseRows& other) const {
    if (rows() != other.rows()) return false;
    for (std::size_t row = 0; row < rows(); ++row) {
      if ((*this)[row] != other[row]) return false;
    }
    return true;
  }

 private:
  std::vector<std::vector<T>> chunks_;
};

/// An integer for each row, in the width that the channel's limits need.
class HeldChannel {
 public:
  HeldChannel(std::int32_t minimum, std::int32_t maximum)
      : width_(minimum >= 0 && maximum <= std::numeric_limits<std::uint8_t>::max() ? Width::Byte
               : minimum >= std::numeric_limits<std::int16_t>::min() &&
                       maximum <= std::numeric_limits<std::int16_t>::max()
                   ? Width::Short
                   : Width::Int) {}

  void grow() { chunks_.emplace_back(kChunkRows * width()); }
  [[nodiscard]] std::int32_t operator[](std::size_t row) const {
    const std::byte* chunk = chunks_[row / kChunkRows].data();
    const std::size_t i = row % kChunkRows;
    if (width_ == Width::Short) return reinterpret_cast<const std::int16_t*>(chunk)[i];
    if (width_ == Width::Byte) return reinterpret_cast<const std::uint8_t*>(chunk)[i];
    return reinterpret_cast<const std::int32_t*>(chunk)[i];
  }
  /// `value` is within the limits.
  void set(std::size_t row, std::int32_t value) {
    std::byte* chunk = chunks_[row / kChunkRows].data();
    const std::size_t i = row % kChunkRows;
    switch (width_) {
      case Width::Byte:
        reinterpret_cast<std::uint8_t*>(chunk)[i] = static_cast<std::uint8_t>(value);
        break;
      case Width::Short:
        reinterpret_cast<std::int16_t*>(chunk)[i] = static_cast<std::int16_t>(value);
        break;
      default:
        reinterpret_cast<std::int32_t*>(chunk)[i] = value;
    }
    assert((*this)[row] == value);
  }
  /// Calls visit(values from that row to the end of its chunk), as the integers that they are.
  template <class Visit>
  void visit(std::size_t row, Visit&& visit) const {
    const std::byte* chunk = chunks_[row / kChunkRows].data();
    const std::size_t i = row % kChunkRows;
    if (width_ == Width::Short) {
      visit(reinterpret_cast<const std::int16_t*>(chunk) + i);
    } else if (width_ == Width::Byte) {
      visit(reinterpret_cast<const std::uint8_t*>(chunk) + i);
    } else {
      visit(reinterpret_cast<const std::int32_t*>(chunk) + i);
    }
  }
  [[nodiscard]] std::size_t width() const { return static_cast<std::size_t>(width_); }  ///< bytes a row
  [[nodiscard]] std::size_t bytes() const {
    return chunks_.size() * (sizeof(std::vector<std::byte>) + kChunkRows * width());
  }
  bool operator==(const HeldChannel&) const = default;

 private:
  enum class Width : std::uint8_t { Byte = 1, Short = 2, Int = 4 };

  Width width_;
  std::vector<std::vector<std::byte>> chunks_;
};

/// What QuantizedGaussians are to a packet, for as long as they are held: about 100 bytes a Gaussian. Rows are added
/// and never taken away; those that are new are all zero.
class HeldGaussians {
 public:
  std::vector<HeldChannel> channels;  ///< [layout.channels()]
  SparseRows<std::uint32_t> object_id;
  SparseRows<std::uint64_t> gaussian_id;  ///< 0 where it is not known

  HeldGaussians() = default;
  explicit HeldGaussians(const StreamLayout& layout);

  [[nodiscard]] std::size_t count() const { return object_id.rows(); }
  /// By kChunkRows rows.
  void grow();
  /// Row `to` becomes what row `from` is.
  void move(std::size_t from, std::size_t to);
  /// The rows become the columns of `from`, of which the first is `first`, without their ids.
  void write(std::span<const std::uint32_t> rows, const QuantizedGaussians& from, std::size_t first);
  /// These rows as columns, in that order.
  [[nodiscard]] QuantizedGaussians gather(std::span<const std::uint32_t> rows) const;
  /// Of memory.
  [[nodiscard]] std::size_t bytes() const;
  bool operator==(const HeldGaussians&) const = default;
};

}  // namespace splatbus::stream
