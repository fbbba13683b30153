#include "evaluation_setup.h"

#include <fmt/format.h>

#include <utility>

#include "parameter_check.h"
#include "probe_round.h"

namespace splatbus::cli {

std::uint64_t EvaluationSetup::enough_gaussians() const {
  return ready_gaussians > 0 ? ready_gaussians : static_cast<std::uint64_t>(budget) * 95 / 100;
}

void apply_settings(const Settings& settings, LaunchFile& file) {
  for (const auto& [name, value] : settings) apply_override(file, fmt::format("{}={}", name, value));
}

LaunchPlan plan_evaluation(const EvaluationSetup& setup, const bus::Address& address, bool paused,
                           const std::function<void(LaunchFile&)>& change) {
  LaunchFile file = read_launch_file(setup.launch_file);
  for (const auto& [name, value] : ring_parameters({.count = setup.cameras, .size = setup.size})) {
    apply_override(file, fmt::format("capture-bridge.{}={}", name, value));
  }
  apply_settings({{"capture-bridge.input_cameras", std::to_string(setup.input_cameras)},
                  {"capture-bridge.input_size", std::to_string(setup.input_size)},
                  {"capture-bridge.sample_budget", std::to_string(setup.budget)},
                  {"trainer.seed", std::to_string(setup.seed)},
                  {"trainer.paused", paused ? "true" : "false"}},
                 file);
  if (change) change(file);
  set_backend(file, setup.backend);
  check_backends(file);
  LaunchPlan plan = plan_launch(file, address, program_directory());
  check_parameters(file, plan);
  return plan;
}

nlohmann::json host_copied_bytes(const std::vector<ProcessStatus>& processes) {
  nlohmann::json bytes = nlohmann::json::object();
  for (const ProcessStatus& process : processes) {
    const auto counter = process.counters.find("host_copied_bytes");
    if (counter != process.counters.end()) bytes[process.name] = static_cast<std::uint64_t>(counter->second);
  }
  return bytes;
}

}  // namespace splatbus::cli
