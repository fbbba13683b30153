#pragma once

#include <cstddef>

namespace splatbus::device {

/// How many of the `bytes` from a device address on lie in memory that this process has: in the allocation that holds
/// the address, and in those that follow it without a gap. 0 where there is none. Reads nothing of that memory. Throws
/// std::runtime_error when the driver cannot be asked.
[[nodiscard]] std::size_t extent_at(const void* address, std::size_t bytes);

}  // namespace splatbus::device
