#pragma once

#include <cstdint>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>

#include "evaluation_setup.h"
#include "figures.h"
#include "supervised_run.h"

namespace splatbus::cli {

/// `splatbus eval fixed`: how good the model gets from fixed cameras, on views that it was never trained with.
struct FixedEvaluationOptions {
  EvaluationSetup setup;  ///< the held-out views have the reference cameras' size
  int iterations = 2000;
  int every = 100;  ///< iterations between evaluations, for which training stops
  int views = 12;   ///< held out, on the same circle turned by 7 degrees
};

struct FixedEvaluationProgress {
  std::uint64_t iteration = 0;
  std::uint64_t gaussians = 0;
  double optimizer_s = 0;  ///< that training has taken so far
  double steps_per_s = 0;
  FigureSummary figures;
};

/// Starts the services on a bus of its own, trains, and writes figures.csv, summary.json and contact_sheet.png to
/// `setup.out`. Returns the summary. Throws std::runtime_error that says what did not come.
nlohmann::json run_fixed_evaluation(const FixedEvaluationOptions& options, const StopSignals& signals,
                                    const std::function<void(const std::string&)>& show_state,
                                    const std::function<void(const FixedEvaluationProgress&)>& show_progress);

}  // namespace splatbus::cli
