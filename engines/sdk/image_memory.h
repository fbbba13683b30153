#pragma once

#include <cstdint>
#include <string>

#include "bus/slab.h"
#include "sdk/splatbus_engine.h"

namespace splatbus::engine_sdk {

/// Of a splatbus_memory. Throws bus::Error that says why when there is no such memory, here or at all.
[[nodiscard]] Device memory_kind(std::uint32_t memory);

/// Why an image's data cannot lie where it says, all its bytes, or an empty string. Host addresses are not checked.
[[nodiscard]] std::string memory_problem(const splatbus_image& image);

}  // namespace splatbus::engine_sdk
