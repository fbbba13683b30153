#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "engine_scene.h"
#include "launch_plan.h"
#include "supervisor.h"

namespace splatbus::cli {

/// What an evaluation launches: fixed cameras around a scene.
struct EvaluationSetup {
  int cameras = 10;  ///< reference cameras, on a circle
  int size = 256;    ///< their pixels, square
  int input_cameras = 40;
  int input_size = 128;
  int budget = 208000;  ///< samples
  std::uint64_t seed = 0;
  std::uint64_t ready_gaussians = 0;  ///< that make the model count as there; 0: 95 % of the budget
  double timeout_s = 1200;            ///< longest wait for any one thing
  std::string backend;                ///< cpu, cuda or auto; empty: the launch file's
  std::filesystem::path launch_file;
  std::filesystem::path out = "out/eval";

  [[nodiscard]] std::uint64_t enough_gaussians() const;
};

/// Parameters of services, "service.key" and value.
using Settings = std::vector<std::pair<std::string, std::string>>;

void apply_settings(const Settings& settings, LaunchFile& file);  ///< throws LaunchError

/// The launch file with the setup's cameras; `paused` is whether the trainer waits to be told. `change` comes last,
/// where it is given. Throws LaunchError.
[[nodiscard]] LaunchPlan plan_evaluation(const EvaluationSetup& setup, const bus::Address& address, bool paused,
                                         const std::function<void(LaunchFile&)>& change = {});

/// Bytes of bulk data that each process says passed through host memory; without those that do not count them.
[[nodiscard]] nlohmann::json host_copied_bytes(const std::vector<ProcessStatus>& processes);

}  // namespace splatbus::cli
