#pragma once

#include <string_view>

namespace splatbus::bus {

/// What addresses begin with.
inline constexpr std::string_view ipc_scheme = "ipc://";
inline constexpr std::string_view tcp_scheme = "tcp://";

}  // namespace splatbus::bus
