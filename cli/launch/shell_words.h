#pragma once

#include <string>
#include <vector>

namespace splatbus::cli {

/// Words as a line that a shell reads as these words: quoted where they have to be.
[[nodiscard]] std::string shell_line(const std::vector<std::string>& words);

}  // namespace splatbus::cli
