#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "stream/page_planes.h"
#include "stream/quantized.h"

// Where the Gaussians of a page lie on a Morton curve: their order in PageCodec::Planes.
namespace splatbus::stream::planes {

using MeanOrigin = std::array<std::int32_t, 3>;

struct Curve {
  MortonGrid grid;
  std::vector<std::pair<std::uint64_t, std::uint32_t>> order;  ///< key at its finest, column
};

/// Columns by their place on the curve from `origin` on (or from the least mean), as fine as keys are; those in one
/// place in their own order. Chooses no low bits.
[[nodiscard]] Curve sorted_curve(const QuantizedGaussians& page, const AttributeChannels& mean,
                                 const std::optional<MeanOrigin>& origin);

/// And how many low bits of theirs are cheaper as they are, where those are multiples of 2^shift.
[[nodiscard]] Curve curve_of(const QuantizedGaussians& page, const AttributeChannels& mean,
                             const std::optional<MeanOrigin>& origin, const std::vector<std::uint8_t>& shift);

}  // namespace splatbus::stream::planes
