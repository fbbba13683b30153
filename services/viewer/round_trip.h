#pragma once

#include <optional>

namespace splatbus::viewer {

/// Of a TCP socket, as the kernel measures it; nullopt where there is none.
[[nodiscard]] std::optional<double> tcp_round_trip_ms(int descriptor);

}  // namespace splatbus::viewer
