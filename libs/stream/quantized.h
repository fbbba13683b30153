#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "gaussians/model.h"
#include "gaussians/pages.h"
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

/// Of columns first, first + 1, ..., in the frame that they are in.
[[nodiscard]] PageBounds bounds_of(const QuantizedGaussians& gaussians, const StreamLayout& layout, std::uint32_t first,
                                   std::uint32_t count);

/// How a channel of the attribute becomes an integer.
[[nodiscard]] coding::Step step_of(const AttributeChannels& channels);

[[nodiscard]] coding::Kind coding_of(Attribute attribute);

inline constexpr std::uint32_t kNotHeld = 0xFFFFFFFFU;

}  // namespace splatbus::stream
