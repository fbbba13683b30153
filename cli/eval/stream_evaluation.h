#pragma once

#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "stream_run.h"

namespace splatbus::cli {

struct StreamOptions {
  StreamRunOptions run{.setup = {.cameras = 8, .size = 160, .input_cameras = 24, .input_size = 128, .budget = 60000}};
  std::vector<double> curve_mbps;  ///< a run each, over a link of that rate; empty: one run
};

/// `splatbus eval stream`: what a viewer behind a link is sent, and what it shows. Writes figures.csv, bitrate.csv,
/// server.csv, figures.png, summary.json and the services' logs to the setup's `out`. Returns the summary: of one run
/// its figures, of a curve those of the last rate, with all of them in "curve". Throws std::runtime_error.
nlohmann::json run_stream_evaluation(const StreamOptions& options, const StopSignals& signals,
                                     const std::function<void(const std::string&)>& show_state);

}  // namespace splatbus::cli
