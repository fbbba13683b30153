#include "demo_run.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "demo_results.h"
#include "engine_scene.h"
#include "launch_plan.h"
#include "parameter_check.h"
#include "private_pipeline.h"
#include "probe_round.h"
#include "scene_view.h"
#include "schema_json.h"
#include "splats/file.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr int kHeldOutCameras = 4;
constexpr int kReferenceCameras = 8;
constexpr int kSize = 160;
constexpr std::int64_t kSecond = 1'000'000'000;
constexpr std::int64_t kRoundNs = 5 * kSecond;
constexpr std::int64_t kRepeatNs = 2 * kSecond;
constexpr std::int64_t kShowNs = 3 * kSecond / 2;
constexpr std::int64_t kMapPatienceNs = kSecond;  ///< the light's depth comes a moment after the probe's picture
constexpr double kFinalTimeoutS = 20;
constexpr double kStillReferenceRate_hz = 0.5;

/// Held-out views half-way between reference cameras.
std::vector<Camera> held_out_cameras() {
  return circle_cameras({.count = kHeldOutCameras, .size = kSize, .phase_degrees = 180.0F / kReferenceCameras});
}

LaunchFile demo_file(const DemoOptions& options, const fs::path& viewer_pictures) {
  LaunchFile file = read_launch_file(options.launch_file);
  for (const auto& [name, value] : ring_parameters({.count = kReferenceCameras, .size = kSize})) {
    apply_override(file, fmt::format("capture-bridge.{}={}", name, value));
  }
  const std::vector<std::pair<std::string, std::string>> settings{
      {"trainer.seed", std::to_string(options.seed)},
      {"viewer.out", viewer_pictures.string()},
  };
  for (const auto& [name, value] : settings) apply_override(file, fmt::format("{}={}", name, value));
  // The engine's flags are its own.
  if (LaunchService* engine = file.find("engine")) {
    engine->args.insert(engine->args.end(), {"--seed", std::to_string(options.seed)});
  }
  if (options.still) apply({.reference_rate_hz = kStillReferenceRate_hz}, file);
  set_backend(file, options.backend);
  check_backends(file);
  return file;
}

class Demo {
 public:
  Demo(const DemoOptions& options, const StopSignals& signals)
      : options_(options),
        pipeline_(signals, options.out / "services.log",
                  options.bus.empty() ? std::nullopt : std::optional(bus::Address::parse(options.bus))),
        viewer_pictures_(pipeline_.folder() / "viewer"),
        depths_(pipeline_.context()),
        probes_(pipeline_.context(), held_out_cameras()),
        view_(1),
        start_ns_(bus::now_ns()) {
    LaunchFile file = demo_file(options, viewer_pictures_);
    gateway_ = settle_gateway(file);
    const LaunchPlan plan = plan_launch(file, pipeline_.address(), program_directory());
    check_parameters(file, plan);
    pipeline_.start(plan, file);
  }

  [[nodiscard]] DemoStart start() const { return {.bus = pipeline_.address().text(), .gateway = gateway_}; }

  Json run(const std::function<void(const DemoState&)>& show) {
    const std::int64_t end_ns = start_ns_ + static_cast<std::int64_t>(options_.seconds * 1e9);
    while (bus::now_ns() < end_ns) step(show, bus::now_ns() - asked_ns_ > kRoundNs);
    finish_last_round(show);
    const auto model = pipeline_.live().copy_average(std::chrono::seconds(10));
    if (!model) throw std::runtime_error("there is no model to write; see " + pipeline_.log().string());
    splats::write_file(options_.out / "model.ply", model->view(), pipeline_.live().scene());
    if (results_.compared.empty())
      throw std::runtime_error("no held-out picture came from the engine; see " + pipeline_.log().string());
    note_pipeline(model->count());
    write_contact_sheet(results_, options_, viewer_pictures_);
    Json summary = summarize_demo(results_, options_, pipeline_.log().string());
    write_text(options_.out / "summary.json", json_text(summary, 2) + "\n");
    pipeline_.stop();
    return summary;
  }

 private:
  void step(const std::function<void(const DemoState&)>& show, bool new_round) {
    // Nothing can be compared before there is a model.
    if (new_round && pipeline_.has_gaussians()) {
      server_.clear();
      lights_.clear();
      depths_.keep(true);
      probes_.begin();
      asked_ns_ = bus::now_ns();
    }
    pipeline_.poll(std::chrono::milliseconds(50));
    probes_.poll(std::chrono::milliseconds(0), [](std::size_t, const ProbePicture&) {});
    draw_what_has_come();
    remember_round();
    count_steps();
    const std::int64_t now = bus::now_ns();
    if (now - shown_ns_ < kShowNs) return;
    DemoState next = state();
    next.pictures_per_s = std::max(0.0, next.pictures - pictures_) * 1e9 / static_cast<double>(now - shown_ns_);
    pictures_ = next.pictures;
    shown_ns_ = now;
    show(next);
  }

  void draw_what_has_come() {
    // Depth maps go within a few frames of their coming.
    for (const auto& [index, probe] : probes_.pictures()) {
      if (auto& lights = lights_[probe.probe_id]; !lights) lights = depths_.find(probe.scene);
    }
    for (const auto& [index, probe] : probes_.pictures()) {
      if (server_.contains(index)) continue;
      const auto& lights = lights_.at(probe.probe_id);
      if (!lights && bus::now_ns() - asked_ns_ < kMapPatienceNs) return;
      const auto picture = view_.render(pipeline_.live(), probe.camera, probe.scene, lights ? &*lights : nullptr);
      if (!picture) return;
      server_[index] = metrics::compare(*picture, probe.picture);
      results_.compared[index] = {.engine = probe.picture, .drawn = *picture, .server = server_[index]};
    }
    if (server_.size() == kHeldOutCameras) depths_.keep(false);
  }

  /// Figures of the newest round of which all views came back, for the live line.
  void remember_round() {
    if (server_.size() == kHeldOutCameras) shown_server_ = summarize(server_).mean.ssim;
    const ViewFigures viewer = viewer_figures();
    if (viewer.size() == kHeldOutCameras) shown_viewer_ = summarize(viewer).mean.ssim;
  }

  /// The viewer's answers of this round.
  [[nodiscard]] ViewFigures viewer_figures() const {
    ViewFigures figures;
    if (probes_.first_id() == 0) return figures;
    for (const auto& [probe_id, quality] : pipeline_.state().viewer_quality) {
      const auto camera = probes_.camera_of(probe_id);
      if (camera && probe_id >= probes_.first_id()) figures[*camera] = quality;
    }
    return figures;
  }

  /// One more round, waited for: its figures are the demo's. What does not come leaves what earlier rounds gave.
  void finish_last_round(const std::function<void(const DemoState&)>& show) {
    const std::int64_t end_ns = bus::now_ns() + static_cast<std::int64_t>(kFinalTimeoutS * 1e9);
    step(show, true);
    std::int64_t asked_again_ns = bus::now_ns();
    ViewFigures viewer = viewer_figures();
    while ((server_.size() < kHeldOutCameras || viewer.size() < kHeldOutCameras) && bus::now_ns() < end_ns) {
      if (bus::now_ns() - asked_again_ns > kRepeatNs) {
        for (std::size_t i = 0; i < kHeldOutCameras; ++i) {
          if (!probes_.pictures().contains(i) || !viewer.contains(i)) probes_.ask_again(i);
        }
        asked_again_ns = bus::now_ns();
      }
      step(show, probes_.first_id() == 0);
      viewer = viewer_figures();
    }
    // By rising id: a later round's answer takes the place of an earlier one's.
    for (const auto& [probe_id, quality] : pipeline_.state().viewer_quality) {
      if (const auto camera = probes_.camera_of(probe_id)) results_.viewer[*camera] = {probe_id, quality};
    }
  }

  void count_steps() {
    const auto& trainer = pipeline_.state().trainer;
    if (trainer.step == 0) return;
    if (first_step_ns_ == 0 || trainer.step < first_step_) {  // the latter: a trainer that began anew
      first_step_ns_ = bus::now_ns();
      first_step_ = trainer.step;
    }
    last_step_ns_ = bus::now_ns();
  }

  [[nodiscard]] double steps_per_s() const {
    const double seconds = static_cast<double>(last_step_ns_ - first_step_ns_) / 1e9;
    return seconds > 0 ? static_cast<double>(pipeline_.state().trainer.step - first_step_) / seconds : 0;
  }

  [[nodiscard]] DemoState state() const {
    DemoState state;
    state.elapsed_s = static_cast<double>(bus::now_ns() - start_ns_) / 1e9;
    const auto processes = pipeline_.processes();
    state.services = processes.size();
    for (const ProcessStatus& process : processes) {
      if (process.state == ProcessState::Running) ++state.running;
      const auto pictures = process.counters.find("cameras_rendered");
      if (process.name == "engine" && pictures != process.counters.end()) state.pictures = pictures->second;
    }
    state.steps_per_s = pipeline_.state().trainer.steps_per_s;
    state.gaussians = pipeline_.state().trainer.gaussians;
    state.ssim_server = shown_server_;
    state.ssim_viewer = shown_viewer_;
    state.wire_mbps = pipeline_.state().stream.wire_mbps;
    return state;
  }

  void note_pipeline(std::size_t gaussians) {
    const PipelineState& state = pipeline_.state();
    results_.last_round = {.first_id = probes_.first_id(), .compared = server_.size(), .timeout_s = kFinalTimeoutS};
    results_.cameras = kHeldOutCameras;
    results_.gaussians = gaussians;
    results_.steps_per_s = steps_per_s();
    results_.wire_mbps_mean = state.stream.wire_mbps_mean;
    results_.wire_mbps_peak = state.stream.wire_mbps_peak;
    if (state.first_picture_ns != 0) {
      results_.first_picture_s = static_cast<double>(state.first_picture_ns - start_ns_) / 1e9;
    }
  }

  const DemoOptions& options_;
  PrivatePipeline pipeline_;
  fs::path viewer_pictures_;
  std::optional<GatewayUrl> gateway_;
  LightDepths depths_;
  ProbeRounds probes_;
  SceneView view_;
  ViewFigures server_;                                          ///< of this round
  std::map<std::uint64_t, std::optional<SceneLights>> lights_;  ///< too, by probe
  DemoResults results_;
  std::optional<double> shown_server_, shown_viewer_;
  std::int64_t asked_ns_ = 0, shown_ns_ = 0;
  double pictures_ = 0;
  std::int64_t first_step_ns_ = 0, last_step_ns_ = 0;
  std::uint64_t first_step_ = 0;
  std::int64_t start_ns_;
};

}  // namespace

Json run_demo(const DemoOptions& options, const StopSignals& signals,
              const std::function<void(const DemoStart&)>& started, const std::function<void(const DemoState&)>& show) {
  fs::create_directories(options.out);
  Demo demo(options, signals);
  started(demo.start());
  return demo.run(show);
}

}  // namespace splatbus::cli
