#pragma once

#include <cstdint>
#include <vector>

#include "stream/planes/shifts.h"
#include "stream/quantized.h"

namespace splatbus::stream::planes {

/// The highest class of each column that all its values admit, numbered from 0; all 0 where that would say little.
[[nodiscard]] std::vector<std::uint8_t> classes_of(const QuantizedGaussians& page, const StreamLayout& layout);

}  // namespace splatbus::stream::planes
