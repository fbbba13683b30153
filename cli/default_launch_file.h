#pragma once

#include <filesystem>
#include <string>

namespace splatbus::cli {

/// launch/NAME under the working folder, or under a folder above the program's. Throws std::runtime_error.
[[nodiscard]] std::filesystem::path default_launch_file(const std::string& name);

}  // namespace splatbus::cli
