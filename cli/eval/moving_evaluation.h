#pragma once

#include <cstdint>
#include <functional>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "dynamics_figures.h"
#include "evaluation_setup.h"
#include "metrics/metrics.h"
#include "supervised_run.h"

namespace splatbus::cli {

struct MovingOptions {
  EvaluationSetup setup{.cameras = 8, .size = 160, .input_cameras = 24, .input_size = 128, .budget = 60000};
  int rig_cameras = 4;   ///< that move with the viewer
  double seconds = 60;   ///< of each run, from its first Gaussian on
  double period_s = 30;  ///< of the viewer's orbit
};

/// One picture from where the viewer was.
struct MovingSample {
  double time_s = 0;
  double angle_deg = 0;  ///< of the eye about the content, from +x towards +z
  metrics::Quality server;
  std::optional<metrics::Quality> viewer;
};

struct MovingResults {
  std::vector<MovingSample> samples;
  TimeWindow window;  ///< that is judged
  double steps_per_s = 0, wire_mbps_mean = 0;
  std::uint64_t gaussians = 0;
};

[[nodiscard]] nlohmann::json summarize_moving(const MovingResults& results);

/// `splatbus eval moving`: a viewer orbits the still scene; the reference cameras stand on its circle ("fixed"), then
/// move with it, as a rig ("rig"). What the server and the viewer draw from the viewer's pose is compared with the
/// engine's picture of it. Writes figures.csv, figures.png, summary.json and the services' logs to `setup.out`. Returns
/// the summary: the figures of both runs under their names, and those of the rig's at the top. Throws
/// std::runtime_error.
nlohmann::json run_moving_evaluation(const MovingOptions& options, const StopSignals& signals,
                                     const std::function<void(const std::string&)>& show_state);

}  // namespace splatbus::cli
