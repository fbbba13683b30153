#pragma once

#include <string>

#include "sdk/splatbus_engine.h"

namespace splatbus::sim {

/// Why this camera cannot be rendered, or an empty string.
[[nodiscard]] std::string camera_problem(const splatbus_camera& camera);

}  // namespace splatbus::sim
