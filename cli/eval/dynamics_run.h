#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <opencv2/core.hpp>
#include <optional>
#include <string>
#include <vector>

#include "dynamics_shots.h"
#include "evaluation_setup.h"
#include "supervised_run.h"

namespace splatbus::cli {

enum class Support { On, Off, Both };

/// Pictures of a sample for the contact sheets.
struct DynamicsPictures {
  std::size_t sample = 0;
  cv::Mat engine, on, off, viewer;  ///< CV_8UC3 BGR; empty when it was not drawn
};

struct DynamicsRunOptions {
  EvaluationSetup setup;
  EngineScene scene;
  double seconds = 60;
  Support support = Support::Both;
  std::filesystem::path log;
  std::filesystem::path viewer_pictures;  ///< folder to which the viewer writes its own
};

/// What the stream had sent, and how late its scenes were, at one time.
struct StreamSecond {
  double time_s = 0;              ///< of the engine
  std::int64_t published_ns = 0;  ///< of the counters
  std::map<std::string, std::uint64_t> total_bytes;
  std::optional<double> state_delay_ms_median, state_delay_ms_p99;
};

/// What one run of the pipeline came to.
struct DynamicsResults {
  std::vector<DynamicsSample> samples;
  std::vector<DynamicsPictures> pictures;  ///< some instants of every camera
  std::vector<DynamicsPictures> motion;    ///< of camera 0, ten a second for a while
  MapsOfCameras mean_maps;                 ///< of the judged window
  TimeWindow window;                       ///< engine seconds that are judged
  std::vector<StreamSecond> stream;        ///< second by second
  std::optional<double> state_delay_ms_median, state_delay_ms_p99, scene_kbps, visibility_kbps;
  /// The viewer's, of the engine's frame to a finished picture, and of visibility (viewer/picture_age.h).
  std::optional<double> picture_age_ms_median, picture_age_ms_p99, object_change_ms_max, visibility_lead_ms_median;
  double wire_mbps_mean = 0, steps_per_s = 0, engine_frames_per_s = 0;
  std::uint64_t gaussians = 0, unpaired_views = 0;
};

inline constexpr std::size_t kDynamicsCameras = 4;  ///< held out, half-way between references

/// Runs the services for so long, compares held-out cameras once a second. `still`: where it is given, maps of the
/// still scene by camera, for the same pixels' SSIM. Throws std::runtime_error.
[[nodiscard]] DynamicsResults run_dynamics(const DynamicsRunOptions& options, const StopSignals& signals,
                                           const MapsOfCameras* still,
                                           const std::function<void(const std::string&)>& show_state);

}  // namespace splatbus::cli
