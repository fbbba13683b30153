#include "dynamics_run.h"

#include <fmt/format.h>

#include <algorithm>
#include <deque>
#include <set>
#include <stdexcept>
#include <utility>

#include "live_scene.h"
#include "pipeline_watch.h"
#include "probe_round.h"
#include "scene_view.h"
#include "shadow_mask.h"
#include "verbs.h"

namespace splatbus::cli {

namespace {

constexpr std::int64_t kSecond = 1'000'000'000;
constexpr std::int64_t kRoundNs = kSecond / 2;
constexpr std::int64_t kRoundPatienceNs = 2 * kSecond;
constexpr std::int64_t kMapPatienceNs = kSecond / 4;     // the light's depth comes a moment after the probe's picture
constexpr std::int64_t kViewerPatienceNs = 3 * kSecond;  // for the last answers
constexpr std::int64_t kShowNs = kSecond;
constexpr std::size_t kMostShots = 512;  // pictures are compared when the run is over, or when there are so many
constexpr int kMovingReach = 5;          // pixels, as far as a window of SSIM does
constexpr int kShadowReach = 10;
constexpr int kSheetInstants = 6;

/// Bytes of the packets that carry the scene, or its visibility.
struct SceneBytes {
  std::uint64_t scene = 0, visibility = 0;
};

SceneBytes scene_bytes(const PipelineState::Stream& stream) {
  SceneBytes bytes;
  for (const auto& [type, total] : stream.total_bytes) {
    if (type == "LightVisibility") {
      bytes.visibility += total;
    } else if (type == "Scene") {
      bytes.scene += total;
    }
  }
  return bytes;
}

class DynamicsRun {
 public:
  DynamicsRun(const DynamicsRunOptions& options, const StopSignals& signals,
              const std::map<std::size_t, cv::Mat>* still, const std::function<void(const std::string&)>& show_state)
      : options_(options),
        signals_(signals),
        still_(still),
        show_state_(show_state),
        plan_(plan_evaluation(options.setup, folder_.address(), false, options.scene)),
        context_(connect(folder_.address())),
        watch_(context_),
        live_(context_),
        depths_(context_),
        probes_(context_, circle_cameras({.count = kDynamicsCameras,
                                          .size = options.setup.size,
                                          .phase_degrees = 180.0F / static_cast<float>(options.setup.cameras)})),
        view_(own_backend(options.setup.backend) == Device::Cpu ? 1 : 4),
        start_ns_(bus::now_ns()),
        run_(plan_, options.log) {
    results_.window = judged_window(options.seconds);
  }

  DynamicsResults run() {
    const auto end_ns = start_ns_ + static_cast<std::int64_t>(options_.seconds * 1e9);
    const auto window_ns = start_ns_ + static_cast<std::int64_t>(results_.window.from_s * 1e9);
    while (bus::now_ns() < end_ns) {
      step(true);
      if (!bytes_before_ && bus::now_ns() >= window_ns) {
        bytes_before_ = scene_bytes(watch_.state().stream);
        bytes_before_ns_ = bus::now_ns();
      }
    }
    note_pipeline();
    while (bus::now_ns() < end_ns + kViewerPatienceNs && (!waiting_.empty() || !viewer_answered())) step(false);
    run_.stop();
    compare_shots();
    take_viewer_figures();
    for (auto& [camera, maps] : ssim_maps_) results_.mean_ssim[camera] = maps.mean();
    if (results_.samples.empty()) {
      throw std::runtime_error("no held-out picture was compared; see " + options_.log.string());
    }
    return std::move(results_);
  }

 private:
  struct Waiting {
    ProbePicture probe;
    std::size_t camera = 0;
    std::int64_t since_ns = 0;
  };
  /// Drawn, and not yet compared.
  struct Shot {
    std::size_t sample = 0;
    cv::Mat engine, on, off;
    cv::Mat moving, shadow;  ///< masks; empty where they could not be had
  };

  /// Masks of a camera's last picture: where something moves, and what the sun lights.
  struct Before {
    cv::Mat moving, lit;
  };

  void step(bool new_rounds) {
    run_.check();
    if (signals_.stop().stop_requested()) throw std::runtime_error("interrupted");
    const std::int64_t since_round_ns = bus::now_ns() - asked_ns_;
    const bool done = probes_.first_id() == 0 || probes_.complete();
    if (new_rounds && live_.published() && live_.published()->count > 0 &&
        since_round_ns > (done ? kRoundNs : kRoundPatienceNs)) {
      depths_.keep(true);
      probes_.begin();
      asked_ns_ = bus::now_ns();
    }
    probes_.poll(std::chrono::milliseconds(10), [this](std::size_t camera, const ProbePicture& picture) {
      waiting_.push_back({.probe = picture, .camera = camera, .since_ns = bus::now_ns()});
    });
    watch_.poll(std::chrono::milliseconds(0));
    live_.poll(std::chrono::milliseconds(0));
    while (!waiting_.empty() && draw(waiting_.front())) waiting_.pop_front();
    if (waiting_.empty() && probes_.complete()) depths_.keep(false);
    if (shots_.size() >= kMostShots) compare_shots();
    if (bus::now_ns() - shown_ns_ > kShowNs) {
      shown_ns_ = bus::now_ns();
      const auto& trainer = watch_.state().trainer;
      show_state_(fmt::format("{:.0f}/{:.0f} s  {} Gaussians  {:.1f} steps/s  {} held-out pictures",
                              static_cast<double>(shown_ns_ - start_ns_) / 1e9, options_.seconds, trainer.gaussians,
                              trainer.steps_per_s, results_.samples.size()));
    }
  }

  /// False while there is hope for the light's depth of that very instant, or no model to draw.
  bool draw(const Waiting& waiting) {
    const ProbePicture& probe = waiting.probe;
    const auto map = depths_.find(probe.scene.version);
    if (map == nullptr && bus::now_ns() - waiting.since_ns < kMapPatienceNs) return false;
    if (!frozen_) {
      if (map == nullptr) return true;  // what it was like at the start has to be known whole
      frozen_ = probe.scene;
      frozen_map_ = map;
    }
    Shot shot{
        .sample = results_.samples.size(), .engine = probe.picture, .on = {}, .off = {}, .moving = {}, .shadow = {}};
    if (options_.support != Support::Off) {
      const auto on = view_.render(live_, probe.camera, probe.scene, map.get());
      if (!on) return false;
      shot.on = *on;
    }
    if (options_.support != Support::On) {
      const auto off = view_.render(live_, probe.camera, *frozen_, frozen_map_.get());
      if (!off) return false;
      shot.off = *off;
    }
    make_masks(waiting, map.get(), shot);
    results_.samples.push_back({.time_s = probe.time_s,
                                .camera = waiting.camera,
                                .probe_id = probe.probe_id,
                                .paired = map != nullptr,
                                .on = {},
                                .off = {},
                                .still = {},
                                .viewer = {}});
    keep_for_sheets(shot, probe.time_s, waiting.camera);
    shots_.push_back(std::move(shot));
    return true;
  }

  void make_masks(const Waiting& waiting, const LightDepths::Map* map, Shot& shot) {
    const ProbePicture& probe = waiting.probe;
    if (probe.object_id.empty()) return;
    std::set<std::uint32_t> can_move;
    for (const auto& [id, transform] : probe.scene.objects) can_move.insert(id);
    Before now{.moving = mask_of(probe.object_id, can_move), .lit = {}};
    shot.moving = grown(now.moving, kMovingReach);
    if (map == nullptr || probe.depth.empty()) return;
    now.lit = lit_surfaces(probe.depth, probe.camera, *map);
    const auto before = before_.find(waiting.camera);
    if (before != before_.end()) {
      shot.shadow = moving_shadow_edges(before->second.lit, now.lit, now.moving | before->second.moving, kShadowReach);
    }
    before_[waiting.camera] = std::move(now);
  }

  void keep_for_sheets(const Shot& shot, double time_s, std::size_t camera) {
    const int instant = static_cast<int>(time_s * kSheetInstants / options_.seconds);
    if (!kept_.insert({instant, camera}).second) return;
    results_.pictures.push_back({.sample = shot.sample, .engine = shot.engine, .on = shot.on, .off = shot.off});
  }

  static MaskedFigures masked_figures(const cv::Mat& ssim_map, const Shot& shot) {
    MaskedFigures figures;
    if (!shot.moving.empty()) figures.moving = masked_mean(ssim_map, shot.moving);
    if (!shot.shadow.empty()) figures.shadow = masked_mean(ssim_map, shot.shadow);
    return figures;
  }

  void compare_shots() {
    for (const Shot& shot : shots_) {
      DynamicsSample& sample = results_.samples[shot.sample];
      const auto figures = [&](const cv::Mat& drawn) -> std::optional<DrawnFigures> {
        if (drawn.empty()) return {};
        cv::Mat map;
        const double ssim = metrics::ssim(drawn, shot.engine, &map);
        DrawnFigures result{.whole = {.psnr_db = metrics::psnr(drawn, shot.engine),
                                      .ssim = ssim,
                                      .flip = metrics::flip(drawn, shot.engine)},
                            .masked = masked_figures(map, shot)};
        if (&drawn == &shot.on && results_.window.contains(sample.time_s)) ssim_maps_[sample.camera].add(map);
        return result;
      };
      sample.on = figures(shot.on);
      sample.off = figures(shot.off);
      if (still_ == nullptr) continue;
      if (const auto map = still_->find(sample.camera); map != still_->end()) {
        sample.still = masked_figures(map->second, shot);
      }
    }
    shots_.clear();
  }

  [[nodiscard]] bool viewer_answered() const {
    return !results_.samples.empty() && watch_.state().viewer_quality.contains(results_.samples.back().probe_id);
  }

  void take_viewer_figures() {
    const auto& answers = watch_.state().viewer_quality;
    for (DynamicsSample& sample : results_.samples) {
      if (const auto answer = answers.find(sample.probe_id); answer != answers.end()) sample.viewer = answer->second;
    }
  }

  void note_pipeline() {
    const PipelineState& state = watch_.state();
    results_.wire_mbps_mean = state.stream.wire_mbps_mean;
    results_.steps_per_s = state.trainer.steps_per_s;
    results_.gaussians = state.trainer.gaussians;
    results_.unpaired_views = state.trainer.unpaired_views;
    if (bytes_before_) {
      const SceneBytes bytes = scene_bytes(state.stream);
      const double seconds = static_cast<double>(bus::now_ns() - bytes_before_ns_) / 1e9;
      results_.scene_kbps = kilobits_per_s(bytes_before_->scene, bytes.scene, seconds);
      results_.visibility_kbps = kilobits_per_s(bytes_before_->visibility, bytes.visibility, seconds);
    }
    for (const ProcessStatus& process : run_.status()) {
      const auto counter = [&](const char* name) -> std::optional<double> {
        const auto found = process.counters.find(name);
        if (found == process.counters.end()) return {};
        return found->second;
      };
      if (process.name == "viewer") {
        results_.state_delay_ms_median = counter("scene_delay_ms_p50");
        results_.state_delay_ms_p99 = counter("scene_delay_ms_p99");
      } else if (process.name == "engine" && counter("frame")) {
        const double rendered = *counter("frame") - counter("frames_skipped").value_or(0);
        results_.engine_frames_per_s = rendered * options_.scene.fps.value_or(0) / std::max(1.0, *counter("frame"));
      }
    }
  }

  const DynamicsRunOptions& options_;
  const StopSignals& signals_;
  const std::map<std::size_t, cv::Mat>* still_;
  const std::function<void(const std::string&)>& show_state_;
  PrivateBusFolder folder_;
  LaunchPlan plan_;
  std::shared_ptr<bus::Context> context_;
  PipelineWatch watch_;
  LiveScene live_;
  LightDepths depths_;
  ProbeRounds probes_;
  SceneView view_;
  std::deque<Waiting> waiting_;
  std::optional<SceneState> frozen_;
  std::shared_ptr<const LightDepths::Map> frozen_map_;
  std::map<std::size_t, Before> before_;  ///< by camera
  std::vector<Shot> shots_;
  std::set<std::pair<int, std::size_t>> kept_;
  std::map<std::size_t, MeanMap> ssim_maps_;
  DynamicsResults results_;
  std::optional<SceneBytes> bytes_before_;
  std::int64_t bytes_before_ns_ = 0, asked_ns_ = 0, shown_ns_ = 0;
  std::int64_t start_ns_;
  SupervisedRun run_;
};

}  // namespace

DynamicsResults run_dynamics(const DynamicsRunOptions& options, const StopSignals& signals,
                             const std::map<std::size_t, cv::Mat>* still,
                             const std::function<void(const std::string&)>& show_state) {
  return DynamicsRun(options, signals, still, show_state).run();
}

}  // namespace splatbus::cli
