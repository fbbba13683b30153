#pragma once

#include <functional>
#include <nlohmann/json.hpp>
#include <string>

#include "evaluation_setup.h"
#include "supervised_run.h"

namespace splatbus::cli {

/// `splatbus eval start`: how soon after the engine's first frame the model is there and trained on. The trainer begins
/// with the first picture, as in any pipeline. Writes summary.json and services.log to `setup.out`, and returns the
/// summary. Throws std::runtime_error that says what did not come.
nlohmann::json run_start_evaluation(const EvaluationSetup& setup, const StopSignals& signals,
                                    const std::function<void(const std::string&)>& show_state);

}  // namespace splatbus::cli
