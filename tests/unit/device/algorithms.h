#pragma once

#include <cstdint>
#include <vector>

#include "device/stream.h"

namespace splatbus::device {

/// 1 / (1 + i) for each index.
[[nodiscard]] std::vector<float> reciprocals(StreamView stream, std::uint32_t count);
/// The values in ascending order; the sort's scratch memory is the stream's.
[[nodiscard]] std::vector<std::uint32_t> sorted(StreamView stream, const std::vector<std::uint32_t>& values);
/// How many are odd.
[[nodiscard]] std::uint32_t count_odd(StreamView stream, const std::vector<std::uint32_t>& values);

}  // namespace splatbus::device
