#include "demo_run.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "gaussians/model.h"
#include "launch_plan.h"
#include "live_scene.h"
#include "metrics/contact_sheet.h"
#include "metrics/image_io.h"
#include "pipeline_watch.h"
#include "probe_round.h"
#include "server_view.h"
#include "supervised_run.h"
#include "verbs.h"

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
constexpr double kFinalTimeoutS = 20;

/// Held-out views half-way between reference cameras.
std::vector<Camera> held_out_cameras() {
  return circle_cameras({.count = kHeldOutCameras, .size = kSize, .phase_degrees = 180.0F / kReferenceCameras});
}

LaunchPlan make_plan(const DemoOptions& options, const bus::Address& address, const fs::path& viewer_pictures) {
  LaunchFile file = read_launch_file(options.launch_file);
  const std::vector<std::pair<std::string, std::string>> settings{
      {"capture-bridge.reference_cameras", std::to_string(kReferenceCameras)},
      {"capture-bridge.reference_size", std::to_string(kSize)},
      {"trainer.seed", std::to_string(options.seed)},
      {"viewer.out", viewer_pictures.string()},
  };
  for (const auto& [name, value] : settings) apply_override(file, fmt::format("{}={}", name, value));
  // The engine's flags are its own.
  if (LaunchService* engine = file.find("engine")) {
    engine->args.insert(engine->args.end(), {"--seed", std::to_string(options.seed)});
  }
  LaunchPlan plan = plan_launch(file, address, program_directory());
  check_parameters(file, plan);
  return plan;
}

class Demo {
 public:
  Demo(const DemoOptions& options, const StopSignals& signals)
      : options_(options),
        signals_(signals),
        address_(options.bus.empty() ? folder_.address() : bus::Address::parse(options.bus)),
        viewer_pictures_(folder_.path() / "viewer"),
        plan_(make_plan(options, address_, viewer_pictures_)),
        context_(connect(address_)),
        watch_(context_),
        live_(context_),
        probes_(context_, held_out_cameras()),
        view_(1),
        start_ns_(bus::now_ns()),
        run_(plan_, options.out / "services.log") {}

  [[nodiscard]] std::string bus() const { return address_.text(); }

  Json run(const std::function<void(const DemoState&)>& show) {
    const std::int64_t end_ns = start_ns_ + static_cast<std::int64_t>(options_.seconds * 1e9);
    while (bus::now_ns() < end_ns) step(show, bus::now_ns() - asked_ns_ > kRoundNs);
    finish_last_round(show);
    const auto model = live_.copy_average(std::chrono::milliseconds(2000));
    if (!model) throw std::runtime_error("there is no model to write");
    write_ply(options_.out / "model.ply", model->view(), live_.scene());
    write_contact_sheet();
    const Json summary = make_summary(model->count());
    write_text(options_.out / "summary.json", summary.dump(2) + "\n");
    run_.stop();
    return summary;
  }

 private:
  void step(const std::function<void(const DemoState&)>& show, bool new_round) {
    run_.check();
    if (signals_.stop().stop_requested()) throw std::runtime_error("interrupted");
    // Nothing can be compared before there is a model.
    if (new_round && live_.model() != nullptr) {
      server_.clear();
      drawn_.clear();
      probes_.begin();
      asked_ns_ = bus::now_ns();
    }
    watch_.poll(std::chrono::milliseconds(50));
    live_.poll(std::chrono::milliseconds(0));
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
    for (const auto& [index, probe] : probes_.pictures()) {
      if (server_.contains(index)) continue;
      const auto picture = view_.render(live_, probe.camera, probe.scene);
      if (!picture) return;
      drawn_[index] = *picture;
      server_[index] = metrics::compare(*picture, probe.picture);
    }
  }

  /// Figures of the newest round of which all views came back, for the live line.
  void remember_round() {
    if (server_.size() == kHeldOutCameras) shown_server_ = summarize(server_).mean.ssim;
    const ViewFigures viewer = viewer_figures();
    if (viewer.size() == kHeldOutCameras) shown_viewer_ = summarize(viewer).mean.ssim;
  }

  [[nodiscard]] ViewFigures viewer_figures() const {
    ViewFigures figures;
    if (probes_.first_id() == 0) return figures;
    for (std::size_t i = 0; i < kHeldOutCameras; ++i) {
      const auto quality = watch_.state().viewer_quality.find(probes_.first_id() + i);
      if (quality != watch_.state().viewer_quality.end()) figures[i] = quality->second;
    }
    return figures;
  }

  /// One more round, waited for: its figures are the demo's.
  void finish_last_round(const std::function<void(const DemoState&)>& show) {
    const std::int64_t end_ns = bus::now_ns() + static_cast<std::int64_t>(kFinalTimeoutS * 1e9);
    step(show, true);
    std::int64_t asked_again_ns = bus::now_ns();
    while (server_.size() < kHeldOutCameras || viewer_figures().size() < kHeldOutCameras) {
      if (bus::now_ns() > end_ns) {
        throw std::runtime_error(
            fmt::format("after {} s: pictures from the engine {}, drawn at the server {}, compared at the viewer {}, "
                        "of {} held-out views; see {}",
                        options_.seconds, probes_.pictures().size(), server_.size(), viewer_figures().size(),
                        kHeldOutCameras, (options_.out / "services.log").string()));
      }
      if (bus::now_ns() - asked_again_ns > kRepeatNs) {
        probes_.ask_for_missing();
        asked_again_ns = bus::now_ns();
      }
      step(show, probes_.first_id() == 0);
    }
    last_viewer_ = viewer_figures();
  }

  void count_steps() {
    const auto& trainer = watch_.state().trainer;
    if (trainer.step == 0) return;
    if (first_step_ns_ == 0 || trainer.step < first_step_) {  // the latter: a trainer that began anew
      first_step_ns_ = bus::now_ns();
      first_step_ = trainer.step;
    }
    last_step_ns_ = bus::now_ns();
  }

  [[nodiscard]] double steps_per_s() const {
    const double seconds = static_cast<double>(last_step_ns_ - first_step_ns_) / 1e9;
    return seconds > 0 ? static_cast<double>(watch_.state().trainer.step - first_step_) / seconds : 0;
  }

  [[nodiscard]] DemoState state() const {
    DemoState state;
    state.elapsed_s = static_cast<double>(bus::now_ns() - start_ns_) / 1e9;
    const auto processes = run_.status();
    state.services = processes.size();
    for (const ProcessStatus& process : processes) {
      if (process.state == ProcessState::Running) ++state.running;
      const auto pictures = process.counters.find("cameras_rendered");
      if (process.name == "engine" && pictures != process.counters.end()) state.pictures = pictures->second;
    }
    state.steps_per_s = watch_.state().trainer.steps_per_s;
    state.gaussians = watch_.state().trainer.gaussians;
    state.ssim_server = shown_server_;
    state.ssim_viewer = shown_viewer_;
    state.wire_mbps = watch_.state().stream.wire_mbps;
    return state;
  }

  void write_contact_sheet() const {
    metrics::ContactSheet sheet{.title = fmt::format("splatbus demo, {:.0f} s: held-out cameras", options_.seconds),
                                .columns = {"engine", "server", "viewer", "FLIP (viewer)"},
                                .rows = {}};
    for (const auto& [index, probe] : probes_.pictures()) {
      const cv::Mat viewer = metrics::read_png(viewer_pictures_ / fmt::format("probe_{}_viewer.png", probe.probe_id));
      cv::Mat map;
      static_cast<void>(metrics::flip(viewer, probe.picture, 67.0, &map));
      const metrics::Quality& at_server = server_.at(index);
      const metrics::Quality& at_viewer = last_viewer_.at(index);
      sheet.rows.push_back(
          {.caption = fmt::format("camera {}", index),
           .figures = {fmt::format("server SSIM {:.3f}", at_server.ssim),
                       fmt::format("PSNR {:.1f} dB", at_server.psnr_db),
                       fmt::format("viewer SSIM {:.3f}", at_viewer.ssim),
                       fmt::format("PSNR {:.1f} dB", at_viewer.psnr_db), fmt::format("FLIP {:.3f}", at_viewer.flip)},
           .pictures = {probe.picture, drawn_.at(index), viewer, metrics::colorize(map)}});
    }
    metrics::write_png(options_.out / "contact_sheet.png", metrics::draw(sheet));
  }

  [[nodiscard]] Json make_summary(std::size_t gaussians) const {
    const metrics::Quality server = summarize(server_).mean;
    const metrics::Quality viewer = summarize(last_viewer_).mean;
    const PipelineState& state = watch_.state();
    return {{"first_picture_s", rounded(static_cast<double>(state.first_picture_ns - start_ns_) / 1e9)},
            {"gaussians", gaussians},
            {"ssim_server", rounded(server.ssim)},
            {"psnr_server", rounded(server.psnr_db)},
            {"flip_server", rounded(server.flip)},
            {"ssim_viewer", rounded(viewer.ssim)},
            {"psnr_viewer", rounded(viewer.psnr_db)},
            {"flip_viewer", rounded(viewer.flip)},
            {"steps_per_s", rounded(steps_per_s())},
            {"wire_mbps_mean", rounded(state.stream.wire_mbps_mean)},
            {"wire_mbps_peak", rounded(state.stream.wire_mbps_peak)},
            {"seconds", options_.seconds},
            {"seed", options_.seed},
            {"cameras", kHeldOutCameras}};
  }

  const DemoOptions& options_;
  const StopSignals& signals_;
  PrivateBusFolder folder_;
  bus::Address address_;
  fs::path viewer_pictures_;
  LaunchPlan plan_;
  std::shared_ptr<bus::Context> context_;
  PipelineWatch watch_;
  LiveScene live_;
  ProbeRounds probes_;
  ServerView view_;
  ViewFigures server_, last_viewer_;
  std::map<std::size_t, cv::Mat> drawn_;
  std::optional<double> shown_server_, shown_viewer_;
  std::int64_t asked_ns_ = 0, shown_ns_ = 0;
  double pictures_ = 0;
  std::int64_t first_step_ns_ = 0, last_step_ns_ = 0;
  std::uint64_t first_step_ = 0;
  std::int64_t start_ns_;
  SupervisedRun run_;
};

}  // namespace

Json run_demo(const DemoOptions& options, const StopSignals& signals,
              const std::function<void(const std::string& bus)>& started,
              const std::function<void(const DemoState&)>& show) {
  fs::create_directories(options.out);
  Demo demo(options, signals);
  started(demo.bus());
  return demo.run(show);
}

}  // namespace splatbus::cli
