#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "bus/parameter_json.h"
#include "launch_plan.h"

namespace splatbus::cli {

/// What `PROGRAM arguments --parameters --json` prints; nullopt when it takes too long, or is no such report, or longer
/// than any.
[[nodiscard]] std::optional<bus::ParameterReport> ask_parameters(const std::filesystem::path& program,
                                                                 std::vector<std::string> arguments,
                                                                 const std::map<std::string, std::string>& environment);

/// Asks each service's program whether it accepts its arguments and parameters (--parameters runs nothing), and throws
/// LaunchError with every one that it does not, at its place. Programs of others are asked only for their parameters,
/// and nothing that runs on is waited for longer than seconds: it is killed, and one of others is taken as it is.
void check_parameters(const LaunchFile& file, const LaunchPlan& plan);

}  // namespace splatbus::cli
