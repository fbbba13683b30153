#pragma once

#include <cstdint>

namespace splatbus::capture_bridge {

[[nodiscard]] inline std::int64_t nanoseconds(double seconds) {
  return static_cast<std::int64_t>(seconds * 1e9);
}

}  // namespace splatbus::capture_bridge
