#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "explore_run.h"
#include "explore_way.h"
#include "launch_plan.h"

namespace splatbus::cli {

struct ExplorePlan {
  LaunchPlan launch;
  std::vector<std::string> viewers;  ///< names on the bus
  std::vector<ExploreWay> ways;      ///< of the viewers
  double apart_m = 0;                ///< along the walk, from one's start to the next one's
};

/// The launch file with the scene, the cameras that follow and viewers that wait at the start of their ways, which are
/// written as path_<viewer>.txt to the setup's `out`. Each viewer writes its pictures of probes to a folder of its name
/// in `pictures`. Throws std::runtime_error.
[[nodiscard]] ExplorePlan plan_exploration(const ExploreRunOptions& options, const bus::Address& address,
                                           const std::filesystem::path& pictures);

/// The walk through its scene, `x y z` a line, that the engine has by --print-walk. Throws std::runtime_error where it
/// has none.
[[nodiscard]] std::string print_walk(const ProcessPlan& engine);

}  // namespace splatbus::cli
