#include "dynamics_run.h"

#include <fmt/format.h>

#include <algorithm>
#include <deque>
#include <set>
#include <stdexcept>
#include <utility>

#include "private_pipeline.h"
#include "probe_round.h"
#include "scene_view.h"
#include "verbs.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kSecond = 1'000'000'000;
// A software engine draws 15 pictures a second: twice as often, half of them would be held-out ones.
constexpr std::int64_t kRoundNs = kSecond;
constexpr std::int64_t kMotionRoundNs = kSecond / 10;
constexpr double kMotionBefore_s = 8;  // the end of the run, and from there for so long:
constexpr double kMotion_s = 2;
constexpr double kMostStart_s = 60;  // until the engine's clock runs and there is a model
constexpr std::int64_t kRoundPatienceNs = 2 * kSecond;
constexpr std::int64_t kMapPatienceNs = kSecond / 4;     // the light's depth comes a moment after the probe's picture
constexpr std::int64_t kViewerPatienceNs = 3 * kSecond;  // for the last answers
constexpr std::int64_t kShowNs = kSecond;
constexpr std::size_t kMostShots = 512;  // pictures are compared when the run is over, or when there are so many
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
  DynamicsRun(const DynamicsRunOptions& options, const StopSignals& signals, const MapsOfCameras* still,
              const std::function<void(const std::string&)>& show_state)
      : options_(options),
        show_state_(show_state),
        pipeline_(signals, options.log),
        depths_(pipeline_.context()),
        probes_(pipeline_.context(),
                circle_cameras({.count = static_cast<int>(kDynamicsCameras),
                                .size = options.setup.size,
                                .phase_degrees = 180.0F / static_cast<float>(options.setup.cameras)})),
        view_(own_backend(options.setup.backend) == Device::Cpu ? 1 : 4),
        results_{.window = judged_window(options.seconds)},
        shots_(results_.window, still, options.viewer_pictures),
        start_ns_(bus::now_ns()) {
    pipeline_.start(plan_evaluation(options.setup, pipeline_.address(), false, [&](LaunchFile& file) {
      apply(options.scene, file);
      apply_override(file, "viewer.out=" + fs::absolute(options.viewer_pictures).string());
      apply_override(file, "viewer.probe_alpha=false");
    }));
  }

  DynamicsResults run() {
    const auto limit_ns = start_ns_ + static_cast<std::int64_t>((options_.seconds + kMostStart_s) * 1e9);
    while (engine_s() < options_.seconds && bus::now_ns() < limit_ns) {
      step(true);
      if (!bytes_before_ && engine_s() >= results_.window.from_s) {
        bytes_before_ = scene_bytes(pipeline_.state().stream);
        bytes_before_ns_ = bus::now_ns();
      }
    }
    note_pipeline();
    const std::int64_t end_ns = bus::now_ns();
    while (bus::now_ns() < end_ns + kViewerPatienceNs && (!waiting_.empty() || !viewer_answered())) step(false);
    pipeline_.stop();
    shots_.compare(results_.samples, 0);
    for (DynamicsPictures& pictures : results_.pictures) {
      pictures.viewer = shots_.viewer_picture(results_.samples[pictures.sample].probe_id);
    }
    results_.mean_maps = shots_.mean_maps();
    if (results_.samples.empty()) {
      throw std::runtime_error("no held-out picture was compared; see " + options_.log.string());
    }
    return std::move(results_);
  }

 private:
  struct Waiting {
    ProbePicture probe;
    std::size_t camera = 0;
    bool extra = false;
    std::int64_t since_ns = 0;
    std::optional<SceneLights> lights;  ///< depth maps go within a few frames of their coming
  };

  void step(bool new_rounds) {
    const std::int64_t since_round_ns = bus::now_ns() - asked_ns_;
    const bool done = probes_.first_id() == 0 || probes_.complete();
    if (new_rounds && pipeline_.has_gaussians() && since_round_ns > (done ? round_ns() : kRoundPatienceNs)) {
      depths_.keep(true);
      // Between two rounds of all cameras.
      extra_round_ = round_ns() != kRoundNs && bus::now_ns() - whole_round_ns_ < kRoundNs;
      if (!extra_round_) whole_round_ns_ = bus::now_ns();
      probes_.begin(extra_round_ ? 1 : kDynamicsCameras);
      asked_ns_ = bus::now_ns();
    }
    pipeline_.poll(std::chrono::milliseconds(10));
    probes_.poll(std::chrono::milliseconds(0), [this](std::size_t camera, const ProbePicture& picture) {
      newest_s_ = picture.time_s;
      newest_ns_ = bus::now_ns();
      waiting_.push_back(
          {.probe = picture, .camera = camera, .extra = extra_round_, .since_ns = newest_ns_, .lights = {}});
    });
    find_lights();
    while (!waiting_.empty() && draw(waiting_.front())) {
      waiting_.pop_front();
      find_lights();
    }
    if (waiting_.empty() && probes_.complete()) depths_.keep(false);
    if (shots_.waiting() >= kMostShots) shots_.compare(results_.samples, kMostShots / 8);
    if (bus::now_ns() - shown_ns_ > kShowNs) {
      shown_ns_ = bus::now_ns();
      note_second();
      const auto& trainer = pipeline_.state().trainer;
      show_state_(fmt::format("{:.0f}/{:.0f} s  {} Gaussians  {:.1f} steps/s  {} held-out pictures", engine_s(),
                              options_.seconds, trainer.gaussians, trainer.steps_per_s, results_.samples.size()));
    }
  }

  [[nodiscard]] bool in_motion(double time_s) const {
    const double since_s = time_s - (options_.seconds - kMotionBefore_s);
    return since_s >= 0 && since_s < kMotion_s;
  }

  /// Of now; 0 before the first picture.
  [[nodiscard]] double engine_s() const {
    return newest_ns_ == 0 ? 0 : newest_s_ + static_cast<double>(bus::now_ns() - newest_ns_) / 1e9;
  }

  [[nodiscard]] std::int64_t round_ns() const { return in_motion(engine_s()) ? kMotionRoundNs : kRoundNs; }

  void find_lights() {
    for (Waiting& waiting : waiting_) {
      if (!waiting.lights) waiting.lights = depths_.find(waiting.probe.scene);
    }
  }

  /// False while there is hope for the light's depth of that very instant, or no model to draw.
  bool draw(const Waiting& waiting) {
    const ProbePicture& probe = waiting.probe;
    const std::optional<SceneLights>& lights = waiting.lights;
    if (!lights && bus::now_ns() - waiting.since_ns < kMapPatienceNs) return false;
    if (!frozen_) {
      if (!lights) return true;  // what it was like at the start has to be known whole
      frozen_ = probe.scene;
      frozen_lights_ = lights;
    }
    DynamicsShots::Drawn drawn{.engine = probe.picture, .on = {}, .off = {}};
    if (options_.support != Support::Off) {
      const auto on = view_.render(pipeline_.live(), probe.camera, probe.scene, lights ? &*lights : nullptr);
      if (!on) return false;
      drawn.on = *on;
    }
    if (options_.support != Support::On) {
      const auto off = view_.render(pipeline_.live(), probe.camera, *frozen_, &*frozen_lights_);
      if (!off) return false;
      drawn.off = *off;
    }
    shots_.add(results_.samples.size(), waiting.camera, probe, lights ? &*lights : nullptr, drawn);
    keep_for_sheets(drawn, probe.time_s, waiting.camera);
    results_.samples.push_back({.time_s = probe.time_s,
                                .camera = waiting.camera,
                                .probe_id = probe.probe_id,
                                .paired = lights.has_value(),
                                .extra = waiting.extra,
                                .objects = ids_of(probe.scene.objects),
                                .on = {},
                                .off = {},
                                .viewer = {},
                                .still = {},
                                .still_ghost_flip = {}});
    return true;
  }

  void keep_for_sheets(const DynamicsShots::Drawn& drawn, double time_s, std::size_t camera) {
    const DynamicsPictures pictures{
        .sample = results_.samples.size(), .engine = drawn.engine, .on = drawn.on, .off = drawn.off, .viewer = {}};
    if (camera == 0 && !drawn.on.empty() && in_motion(time_s)) results_.motion.push_back(pictures);
    const int instant = static_cast<int>(time_s * kSheetInstants / options_.seconds);
    if (kept_.insert({instant, camera}).second) results_.pictures.push_back(pictures);
  }

  [[nodiscard]] bool viewer_answered() const {
    return !results_.samples.empty() && pipeline_.state().viewer_quality.contains(results_.samples.back().probe_id);
  }

  void note_pipeline() {
    const PipelineState& state = pipeline_.state();
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
    results_.state_delay_ms_median = counter("viewer", "scene_delay_ms_p50");
    results_.state_delay_ms_p99 = counter("viewer", "scene_delay_ms_p99");
    results_.picture_age_ms_median = counter("viewer", "picture_age_ms_p50");
    results_.picture_age_ms_p99 = counter("viewer", "picture_age_ms_p99");
    results_.object_change_ms_max = counter("viewer", "object_change_ms_max");
    results_.visibility_lead_ms_median = counter("viewer", "visibility_lead_ms_p50");
    if (const std::optional<double> frames = counter("engine", "frame")) {
      const double rendered = *frames - counter("engine", "frames_skipped").value_or(0);
      results_.engine_frames_per_s = rendered * options_.scene.fps.value_or(0) / std::max(1.0, *frames);
    }
  }

  /// The process's own, as its last heartbeat had it.
  [[nodiscard]] std::optional<double> counter(const char* process, const char* name) const {
    for (const ProcessStatus& status : pipeline_.processes()) {
      if (status.name != process) continue;
      if (const auto found = status.counters.find(name); found != status.counters.end()) return found->second;
    }
    return {};
  }

  void note_second() {
    const std::int64_t published_ns = pipeline_.state().stream.published_ns;
    if (newest_ns_ == 0 || published_ns == 0) return;
    if (!results_.stream.empty() && results_.stream.back().published_ns == published_ns) return;
    results_.stream.push_back({.time_s = engine_s(),
                               .published_ns = published_ns,
                               .total_bytes = pipeline_.state().stream.total_bytes,
                               .state_delay_ms_median = counter("viewer", "scene_delay_ms_p50"),
                               .state_delay_ms_p99 = counter("viewer", "scene_delay_ms_p99")});
  }

  const DynamicsRunOptions& options_;
  const std::function<void(const std::string&)>& show_state_;
  PrivatePipeline pipeline_;
  LightDepths depths_;
  ProbeRounds probes_;
  SceneView view_;
  std::deque<Waiting> waiting_;
  std::optional<SceneState> frozen_;
  std::optional<SceneLights> frozen_lights_;
  std::set<std::pair<int, std::size_t>> kept_;
  DynamicsResults results_;
  DynamicsShots shots_;
  std::optional<SceneBytes> bytes_before_;
  std::int64_t bytes_before_ns_ = 0, asked_ns_ = 0, shown_ns_ = 0;
  bool extra_round_ = false;
  std::int64_t whole_round_ns_ = 0;
  double newest_s_ = 0;         ///< engine time of the newest picture,
  std::int64_t newest_ns_ = 0;  ///< which came then
  std::int64_t start_ns_;
};

}  // namespace

DynamicsResults run_dynamics(const DynamicsRunOptions& options, const StopSignals& signals, const MapsOfCameras* still,
                             const std::function<void(const std::string&)>& show_state) {
  return DynamicsRun(options, signals, still, show_state).run();
}

}  // namespace splatbus::cli
