#pragma once

#include <string>

namespace splatbus::cli {

/// "3 min 2 s"
[[nodiscard]] std::string duration_text(double seconds);
/// "512.3 MiB"
[[nodiscard]] std::string bytes_text(double bytes);

}  // namespace splatbus::cli
