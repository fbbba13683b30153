#pragma once

#include <cstdint>

namespace splatbus::stream {

/// The visibility of a light that nothing hides, of 8 bits.
inline constexpr std::uint8_t kAllSeen = 255;

}  // namespace splatbus::stream
