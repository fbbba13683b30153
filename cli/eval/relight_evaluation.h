#pragma once

#include <functional>
#include <glm/glm.hpp>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "evaluation_setup.h"
#include "supervised_run.h"

namespace splatbus::cli {

/// `splatbus eval relight`: how true the model is under lights that it was never trained with.
struct RelightEvaluationOptions {
  EvaluationSetup setup{.cameras = 8, .size = 160, .input_cameras = 24, .input_size = 128, .budget = 150000};
  int iterations = 3000;
  int views = 4;                                         ///< held out, half-way between reference cameras
  std::vector<double> turns_deg{60, 90, 120, 150, 180};  ///< of the sun about the vertical, away from its first place
};

/// Trains under one sun, stops for good, then turns the engine's sun, and takes two point lights in its place, and
/// compares held-out views, drawn with visibility for that light. Writes summary.json and contact_sheet.png to
/// `setup.out`. Returns the summary. Throws std::runtime_error that says what did not come.
nlohmann::json run_relight_evaluation(const RelightEvaluationOptions& options, const StopSignals& signals,
                                      const std::function<void(const std::string&)>& show_state);

/// Degrees about the vertical from +x towards +z of a direction.
[[nodiscard]] double azimuth_deg(const glm::vec3& direction);
/// `direction` turned about the vertical by so much, from +x towards +z.
[[nodiscard]] glm::vec3 turned(const glm::vec3& direction, double degrees);

}  // namespace splatbus::cli
