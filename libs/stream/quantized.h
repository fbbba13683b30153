#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "gaussians/model.h"
#include "stream/coding.h"
#include "stream/layout.h"

namespace splatbus::stream {

/// Gaussians as the integers that travel: what server and viewer hold alike, bit for bit. Column i of every plane is
/// one Gaussian; in a held state i is its stream slot.
struct QuantizedGaussians {
  std::vector<std::vector<std::int32_t>> channels;  ///< [layout.channels()][count]
  std::vector<std::uint32_t> object_id;
  std::vector<std::uint64_t> gaussian_id;  ///< 0 where it is not known (yet)

  QuantizedGaussians() = default;
  explicit QuantizedGaussians(const StreamLayout& layout, std::size_t count = 0);

  [[nodiscard]] std::size_t count() const { return object_id.size(); }
  void resize(std::size_t count);
  void append(const QuantizedGaussians& other);
  /// The columns `columns`, in that order.
  [[nodiscard]] QuantizedGaussians gather(std::span<const std::uint32_t> columns) const;
  /// Takes out the columns `ascending` (sorted, distinct, in range); those above close the gaps in order.
  void remove(std::span<const std::uint32_t> ascending);

  bool operator==(const QuantizedGaussians&) const = default;
};

/// Removes elements at the ascending indices.
template <class T>
void remove_at(std::vector<T>& values, std::span<const std::uint32_t> ascending) {
  if (ascending.empty()) return;
  std::size_t to = ascending[0], next = 0;
  for (std::size_t from = to; from < values.size(); ++from) {
    if (next < ascending.size() && ascending[next] == from) {
      ++next;
    } else {
      values[to++] = values[from];
    }
  }
  values.resize(to);
}

/// How a channel of the attribute becomes an integer.
[[nodiscard]] coding::Step step_of(const AttributeChannels& channels);

/// Nearest integers of columns [0, gaussians.count) of a view, into `out` (resized; buffers are reused). Reads
/// parameters, normal and visibility (Transfer; null: up, 1), object_id and gaussian_id where they are not null. Values
/// are clamped to the layout's range. `usable[i]` is 0 where a value was not finite; that column is then all zero.
///
/// `held_column[i]` is the column of `held` that Gaussian i has, or kNotHeld: its rotation is then written as the
/// equivalent one nearest to that which is held. Both may be null.
inline constexpr std::uint32_t kNotHeld = 0xFFFFFFFFU;
void quantize(const GaussiansView& gaussians, const StreamLayout& layout, QuantizedGaussians& out,
              std::vector<std::uint8_t>& usable, const QuantizedGaussians* held = nullptr,
              const std::uint32_t* held_column = nullptr);

/// Model parameters of one Gaussian attribute from its integers: writes the attribute's parameter channels (or normal,
/// or visibility) of columns `columns` into planes of `stride`. `normal` and `visibility` may be null for Radiance.
struct DequantizedChannels {
  float* parameters = nullptr;  ///< [layout.parameters().channels()][stride]
  float* normal = nullptr;      ///< [3][stride]
  float* visibility = nullptr;  ///< [stride]
  std::size_t stride = 0;
};
void dequantize(const QuantizedGaussians& gaussians, const StreamLayout& layout, Attribute attribute,
                std::span<const std::uint32_t> columns, const DequantizedChannels& out);

}  // namespace splatbus::stream
