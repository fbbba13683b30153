#pragma once

#include <cstdint>

namespace splatbus::bus {

/// CLOCK_MONOTONIC, nanoseconds.
[[nodiscard]] std::int64_t now_ns();

}  // namespace splatbus::bus
