#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>

#include "figures.h"
#include "stop_signals.h"

namespace splatbus::cli {

/// `splatbus eval fixed`: how good the model gets from fixed cameras, on views that it was never trained with.
struct FixedEvaluationOptions {
  int cameras = 10;  ///< reference cameras, on a circle
  int size = 256;    ///< their pixels, square; the held-out views have the same
  int iterations = 2000;
  int every = 100;  ///< iterations between evaluations
  int views = 12;   ///< held out, on the same circle turned by 7 degrees
  int input_cameras = 40;
  int input_size = 128;
  int budget = 208000;  ///< samples
  std::uint64_t seed = 0;
  double timeout_s = 1200;  ///< longest wait for any one thing
  std::filesystem::path launch_file;
  std::filesystem::path out = "out/eval";
};

struct FixedEvaluationProgress {
  std::uint64_t iteration = 0;
  std::uint64_t gaussians = 0;
  double steps_per_s = 0;
  FigureSummary figures;
};

/// Starts the services on a bus of its own, trains, and writes figures.csv, summary.json and contact_sheet.png to
/// `out`. Returns the summary. Throws std::runtime_error that says what did not come.
nlohmann::json run_fixed_evaluation(const FixedEvaluationOptions& options, const StopSignals& signals,
                                    const std::function<void(const std::string&)>& show_state,
                                    const std::function<void(const FixedEvaluationProgress&)>& show_progress);

}  // namespace splatbus::cli
