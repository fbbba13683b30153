#pragma once

#include <functional>
#include <nlohmann/json.hpp>
#include <string>

#include "explore_run.h"

namespace splatbus::cli {

struct ExploreOptions {
  ExploreRunOptions run{.setup = {.cameras = 4, .size = 160, .input_cameras = 24, .input_size = 128, .budget = 60000},
                        .scene = "world"};
  bool compare = false;  ///< with the same run without freezing
  bool halve = false;    ///< with the same run under half of the memory and disk that it took
  bool alone = false;    ///< with runs in which each of two viewers is alone
};

/// Figures of one run. "At 30 s" is a third of the walk where that is sooner, and each is the mean of the 10 s about it
/// or before it, a sixth of the walk at most; null where nothing was measured.
[[nodiscard]] nlohmann::json summarize_exploration(const ExploreResults& results);

/// `splatbus eval explore`: a viewer walks through the engine's world, back over its own path, and is at the start
/// again at once. Writes figures.csv, figures.png, contact_sheet.png, summary.json, the paths and the services' log to
/// the setup's `out`, of a run to compare with likewise under other names. Returns the summary. Throws
/// std::runtime_error.
nlohmann::json run_explore_evaluation(const ExploreOptions& options, const StopSignals& signals,
                                      const std::function<void(const std::string&)>& show_state);

}  // namespace splatbus::cli
