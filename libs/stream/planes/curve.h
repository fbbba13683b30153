#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "stream/planes/morton.h"
#include "stream/quantized.h"

// Where the Gaussians of a page lie on a Morton curve: their order in PageCodec::Planes.
namespace splatbus::stream::planes {

using MeanOrigin = std::array<std::int32_t, 3>;

class Curve {
 public:
  MortonGrid grid;                   ///< of the finest keys there are; later with fewer bits
  std::vector<std::uint32_t> order;  ///< [count] columns by their place; those in one place in their own order

  /// Decides how many low bits of the means are cheaper as they are, where those of lane i, by the order, are multiples
  /// of 2^shift[i].
  void choose_low_bits(std::span<const std::uint8_t> shift);

 private:
  friend Curve sorted_curve(const QuantizedGaussians&, const AttributeChannels&, const std::optional<MeanOrigin>&);
  std::array<int, 3> extent_bits_{};  ///< of the means above their origin
  int finest_ = 0;                    ///< low bits of the finest keys
  std::vector<std::uint64_t> keys_;   ///< [count] finest, ascending
};

/// From `origin` on, or from the least mean. The order is the same whatever number of low bits is chosen.
[[nodiscard]] Curve sorted_curve(const QuantizedGaussians& page, const AttributeChannels& mean,
                                 const std::optional<MeanOrigin>& origin);

}  // namespace splatbus::stream::planes
