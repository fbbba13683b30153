#pragma once

#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "dynamics_run.h"

namespace splatbus::cli {

/// `splatbus eval dynamics`: how true the model stays while sun and objects move. "On" is the model under the light,
/// the transforms and the visibility of the very frame that it is compared with; "off" the same model under those of
/// the run's first frame that was compared, for ever.
enum class SceneLight { FixedSun, TurningSun, PointLights };

struct DynamicsOptions {
  EvaluationSetup setup{.cameras = 8, .size = 160, .input_cameras = 24, .input_size = 128, .budget = 60000};
  double seconds = 60;
  double still_seconds = 40;  ///< of the same scene standing still, before; 0: without
  bool still_only = false;
  std::vector<SceneLight> lights{SceneLight::TurningSun, SceneLight::FixedSun, SceneLight::PointLights};
  double sun_rate_deg_s = 15;
  double fps = 30;
  double reference_rate_hz = 10;
  Support support = Support::Both;
};

/// Runs the still scene, then the living one under each of `lights`, and writes figures.csv, summary.json, a log of the
/// services and contact sheets (turning_0.png ...: run and camera) to `setup.out`. Returns the summary: figures of the
/// first of `lights` at its top, those of each under its name; null where a figure could not be had. Throws
/// std::runtime_error.
nlohmann::json run_dynamics_evaluation(const DynamicsOptions& options, const StopSignals& signals,
                                       const std::function<void(const std::string&)>& show_state);

[[nodiscard]] nlohmann::json summarize_still(const DynamicsResults& still);
[[nodiscard]] nlohmann::json summarize_living(const DynamicsResults& living);

}  // namespace splatbus::cli
