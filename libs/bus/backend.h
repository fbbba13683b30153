#pragma once

#include <string>

#include "device/device.h"

namespace splatbus::bus {

/// "cpu", "cuda" or "auto": CUDA where this build has it and a device is usable. A service does its work there, and the
/// slabs that it makes lie there; what it reads may lie anywhere. Throws Error that says why CUDA, asked for by name,
/// cannot be had.
[[nodiscard]] Device choose_backend(const std::string& text);

}  // namespace splatbus::bus
