#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "gaussians/model.h"
#include "stream/quantized.h"

namespace splatbus::stream {

/// The floats that a rasteriser reads, kept beside the integers. Columns grow by doubling, so that a model which
/// arrives chunk by chunk is not copied once a chunk.
class DisplayGaussians {
 public:
  explicit DisplayGaussians(const StreamLayout& layout) : layout_(layout) {}

  /// Adds the columns [count(), gaussians.count()).
  void extend(const QuantizedGaussians& gaussians);
  /// Writes the attribute of these columns anew.
  void update(const QuantizedGaussians& gaussians, Attribute attribute, std::span<const std::uint32_t> columns);
  void update_objects(const QuantizedGaussians& gaussians, std::span<const std::uint32_t> columns);
  void remove(std::span<const std::uint32_t> ascending);
  /// Column i becomes what column order[i] was; a permutation of all columns.
  void reorder(std::span<const std::uint32_t> order);

  [[nodiscard]] std::size_t count() const { return count_; }
  /// Valid until the next change. gaussian_id, surface_point, flags and cell are null.
  [[nodiscard]] GaussiansView view() const;

 private:
  void reserve(std::size_t columns);
  [[nodiscard]] DequantizedChannels planes();

  StreamLayout layout_;
  std::size_t count_ = 0, stride_ = 0;
  std::vector<float> parameters_, normal_, visibility_;
  std::vector<std::uint32_t> object_id_;
};

}  // namespace splatbus::stream
