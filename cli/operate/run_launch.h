#pragma once

#include <string>

#include "launch_file.h"
#include "launch_plan.h"

namespace splatbus::cli {

struct RunLaunch {
  LaunchFile file;
  LaunchPlan plan;
  std::string invitation;  ///< printed at the start when not empty
  bool json = false;
  double seconds = 0;   ///< stop after that long; 0: on a signal or 'splatbus down'
  bool detach = false;  ///< in the background: returns when everything is ready
  double ready_within_s = 120;
};

/// Runs the plan as the one supervisor of its bus, open to the operator's verbs. The exit status: 1 when, at the end,
/// or for `detach` within its time, anything does not run. Throws SupervisorRuns. Call it before any thread starts.
int run_launch(const RunLaunch& launch);

}  // namespace splatbus::cli
