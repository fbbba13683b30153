#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>
#include <optional>
#include <string>

#include "demo_run.h"
#include "metrics/metrics.h"

namespace splatbus::cli {

/// What a demo came to: the newest figures of each held-out camera, and of the pipeline.
struct DemoResults {
  struct Compared {
    cv::Mat engine, drawn;
    metrics::Quality server;
  };
  struct ViewerAnswer {
    std::uint64_t probe_id = 0;
    metrics::Quality quality;
  };
  std::map<std::size_t, Compared> compared;    ///< at the server, by camera
  std::map<std::size_t, ViewerAnswer> viewer;  ///< by camera

  struct LastRound {
    std::uint64_t first_id = 0;  ///< of its probes: answers to earlier ones are stale
    std::size_t compared = 0;    ///< views, at the server
    double timeout_s = 0;        ///< how long it was waited for
  } last_round;
  std::size_t cameras = 0;  ///< held out
  std::size_t gaussians = 0;
  std::optional<double> first_picture_s;
  double steps_per_s = 0, wire_mbps_mean = 0, wire_mbps_peak = 0;
};

/// Draws every camera's pictures to contact_sheet.png in the folder of the options; the viewer's own lie in
/// `viewer_pictures`. Throws std::runtime_error.
void write_contact_sheet(const DemoResults& results, const DemoOptions& options,
                         const std::filesystem::path& viewer_pictures);

/// The summary that run_demo() returns; its note names `log_path`.
[[nodiscard]] nlohmann::json summarize_demo(const DemoResults& results, const DemoOptions& options,
                                            const std::string& log_path);

}  // namespace splatbus::cli
