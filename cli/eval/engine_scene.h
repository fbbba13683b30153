#pragma once

#include <optional>
#include <string>
#include <vector>

#include "launch_file.h"

namespace splatbus::cli {

/// What the built-in engine shows, and how often references are taken of it.
struct EngineScene {
  bool moving_objects = false;
  double sun_rate_deg_s = 0;
  int point_lights = 0;          ///< that move; above 0 it is night
  std::optional<double> fps;     ///< nullopt: what the launch file says
  double reference_rate_hz = 0;  ///< 0: each camera once
};

/// Writes it into the services `engine` and `capture-bridge` of a launch file, in place of what that says. Throws
/// LaunchError where one of them is missing.
void apply(const EngineScene& scene, LaunchFile& file);

/// A flag with a value among a program's arguments, in place of one that is there.
void set_flag(std::vector<std::string>& args, const std::string& flag, const std::string& value);

}  // namespace splatbus::cli
