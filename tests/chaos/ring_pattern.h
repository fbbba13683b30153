#pragma once

#include <cstddef>
#include <cstdint>

namespace splatbus::chaos {

/// Slots of kRingWords words that all say the same, how manieth write it was.
inline constexpr std::size_t kRingSlots = 2, kRingWords = 16;
inline constexpr std::uint64_t kRingWrites = 6;

}  // namespace splatbus::chaos
