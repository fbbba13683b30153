#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <opencv2/core.hpp>
#include <optional>
#include <string>
#include <vector>

#include "evaluation_setup.h"
#include "explore_way.h"
#include "pipeline_watch.h"
#include "supervised_run.h"

namespace splatbus::cli {

struct ExploreRunOptions {
  EvaluationSetup setup;
  std::string scene;             ///< the engine's --scene; empty: what the launch file says
  std::filesystem::path path;    ///< a polyline, `x y z` a line; empty: the engine's own, by --print-walk
  std::filesystem::path world;   ///< folder that keeps the world; empty: none
  double seconds = 300;          ///< of the walk out
  std::optional<double> back_s;  ///< of the way back over its own path; nullopt: half of that
  double speed_m_s = 1.4;
  double stay_s = 8;   ///< after the teleport
  int viewers = 1;     ///< the second walks ahead of the first
  double start_m = 0;  ///< along the way, where the first viewer begins
  /// Ceilings of the trainer's memory, wherever the model is, and of its world folder, MiB; 0: none.
  std::uint64_t memory_mb = 0, disk_mb = 0;
  std::optional<std::uint64_t> max_gaussians;
  bool rests = true;  ///< pages freeze, and those outside of a view are left out of its steps
};

/// What a viewer drew from where it was.
struct ViewerFigures {
  double ssim = 0, flip = 0;
  std::optional<double> unmodelled_share;
};

/// Gaussians that the expander has inserted so far, by reason (InsertReasons).
struct Inserted {
  double bare = 0, hole = 0, fill = 0;
};

/// The run at one moment, about once a second. Its figures may not have come.
struct ExploreSample {
  double time_s = 0;  ///< of the walk
  ExplorePhase phase = ExplorePhase::Out;
  glm::vec3 eye{0};  ///< of the first viewer
  PipelineState::Trainer trainer;
  std::uint64_t page_bytes = 0;
  std::uint64_t resident_bytes = 0;  ///< of all services, without the engine
  std::optional<double> draw_ms;     ///< of the first viewer's last picture
  Inserted inserted;
  std::vector<std::optional<ViewerFigures>> viewers;
};

/// Pictures of a sample for the contact sheet, CV_8UC3 BGR; `viewer` is empty where there is none.
struct ExplorePictures {
  std::size_t sample = 0;
  cv::Mat engine, viewer;
};

struct ExploreResults {
  std::vector<ExploreSample> samples;
  std::vector<ExplorePictures> pictures;  ///< the first one of each of the walk's parts
  std::vector<ExplorePictures> worst;     ///< the one of least SSIM
  Stations stations;
  double out_s = 0, walk_s = 0;
  double apart_m = 0;                      ///< along the walk, from one viewer's start to the next one's
  std::optional<double> teleport_whole_s;  ///< until at most a hundredth of the picture was not modelled
  /// Pictures of viewers' own places that were asked for and never compared, by who did not answer.
  int unanswered_by_engine = 0, unanswered_by_viewer = 0;
};

/// The services with viewers that walk. Writes the viewers' path files and a log of the services, named after `name`,
/// to the setup's `out`. Throws std::runtime_error.
[[nodiscard]] ExploreResults run_exploration(const ExploreRunOptions& options, const std::string& name,
                                             const StopSignals& signals,
                                             const std::function<void(const std::string&)>& show_state);

}  // namespace splatbus::cli
