#pragma once

#include <span>

#include "stream/quantized.h"

namespace splatbus::stream {

/// Rounds the values of a page to what shows: an error of a Gaussian's value counts in pictures by its opacity and the
/// area that it covers, so that the small and the faint may be coarse where the large and the opaque are fine. Values
/// stay integers of the layout, multiples of a power of two that follows from the Gaussian alone; PageCodec::Planes
/// then leaves out the zeros. Rounding twice is rounding once, and whoever holds a page holds it rounded.
///
/// `coarseness`: octaves; one more is one bit less a value, of those that are not as fine as the layout already.
/// `weight`: [count] or empty; what a Gaussian's opacity is multiplied by, such as how much of it is seen.
void round_page(QuantizedGaussians& page, const StreamLayout& layout, float coarseness,
                std::span<const float> weight = {});

}  // namespace splatbus::stream
