#pragma once

#include <string>

namespace splatbus::viewer {

/// A file that is not there yet, named after the time: splatbus_2024-05-31_17-20-59.png in `folder`, which is made
/// where there is none; empty: the current one. Throws std::runtime_error naming the folder.
[[nodiscard]] std::string new_file(const std::string& folder, const std::string& extension);

}  // namespace splatbus::viewer
