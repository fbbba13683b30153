#pragma once

#include <map>
#include <string>

namespace splatbus::cli {

/// A launch file's text with these parameters of a service set; comments and layout stay as they are. A value that the
/// file has is replaced where it stands; others are added below the service's other parameters, or in a block of their
/// own. Throws LaunchError when the file has no such service, or its text cannot be changed so: the service comes from
/// an included file, or its value is an alias or goes over several lines.
[[nodiscard]] std::string with_parameters(const std::string& yaml, const std::string& path, const std::string& service,
                                          const std::map<std::string, std::string>& changes);

}  // namespace splatbus::cli
