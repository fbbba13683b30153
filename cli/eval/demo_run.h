#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "figures.h"
#include "gateway_url.h"
#include "supervised_run.h"

namespace splatbus::cli {

struct DemoOptions {
  double seconds = 60;
  bool still = false;  ///< sun and objects rest, whatever the launch file says
  std::uint64_t seed = 0;
  std::filesystem::path out = "out/demo";
  std::filesystem::path launch_file;
  std::string bus;      ///< empty: a folder of its own
  std::string backend;  ///< cpu, cuda or auto; empty: the launch file's
};

/// Where to look inside.
struct DemoStart {
  std::string bus;
  std::optional<GatewayUrl> gateway;  ///< where the launch file has one
};

/// A live line's figures.
struct DemoState {
  double elapsed_s = 0;
  std::size_t running = 0, services = 0;
  double pictures = 0, pictures_per_s = 0;  ///< that the engine has rendered, over all cameras
  double steps_per_s = 0;
  std::uint64_t gaussians = 0;
  std::optional<double> ssim_server, ssim_viewer;
  double wire_mbps = 0;
};

/// Launches the demo's services, compares held-out cameras at the server and at the viewer while they run, and writes
/// contact_sheet.png, model.ply and summary.json to `out`. Returns the summary: where a camera's last answer from the
/// viewer did not come, with an earlier one and a "note" that says so; null figures without any. Throws
/// std::runtime_error.
nlohmann::json run_demo(const DemoOptions& options, const StopSignals& signals,
                        const std::function<void(const DemoStart&)>& started,
                        const std::function<void(const DemoState&)>& show);

}  // namespace splatbus::cli
