#include "demo_run.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "gaussians/model.h"
#include "json_text.h"
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
  set_backend(file, options.backend);
  check_backends(file);
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
        view_(own_backend(options.backend), 1),
        start_ns_(bus::now_ns()),
        run_(plan_, options.out / "services.log") {}

  [[nodiscard]] std::string bus() const { return address_.text(); }

  Json run(const std::function<void(const DemoState&)>& show) {
    const std::int64_t end_ns = start_ns_ + static_cast<std::int64_t>(options_.seconds * 1e9);
    while (bus::now_ns() < end_ns) step(show, bus::now_ns() - asked_ns_ > kRoundNs);
    finish_last_round(show);
    const auto model = live_.copy_average(std::chrono::seconds(10));
    if (!model) throw std::runtime_error("there is no model to write; see " + log_path());
    write_ply(options_.out / "model.ply", model->view(), live_.scene());
    if (compared_.empty()) throw std::runtime_error("no held-out picture came from the engine; see " + log_path());
    write_contact_sheet();
    const Json summary = make_summary(model->count());
    write_text(options_.out / "summary.json", json_text(summary, 2) + "\n");
    run_.stop();
    return summary;
  }

 private:
  void step(const std::function<void(const DemoState&)>& show, bool new_round) {
    run_.check();
    if (signals_.stop().stop_requested()) throw std::runtime_error("interrupted");
    // Nothing can be compared before there is a model.
    if (new_round && live_.published()) {
      server_.clear();
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
      server_[index] = metrics::compare(*picture, probe.picture);
      compared_[index] = {.engine = probe.picture, .drawn = *picture, .server = server_[index]};
    }
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
    for (const auto& [probe_id, quality] : watch_.state().viewer_quality) {
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
    for (const auto& [probe_id, quality] : watch_.state().viewer_quality) {
      if (const auto camera = probes_.camera_of(probe_id)) viewer_known_[*camera] = {probe_id, quality};
    }
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

  /// The viewer's picture of a probe; empty when there is none that can be read.
  [[nodiscard]] cv::Mat viewer_picture(std::uint64_t probe_id, const cv::Size& size) const {
    try {
      cv::Mat picture = metrics::read_png(viewer_pictures_ / fmt::format("probe_{}_viewer.png", probe_id));
      if (picture.size() == size) return picture;
    } catch (const std::exception&) {
      // The viewer was killed while it wrote it.
    }
    return {};
  }

  void write_contact_sheet() const {
    metrics::ContactSheet sheet{.title = fmt::format("splatbus demo, {:.0f} s: held-out cameras", options_.seconds),
                                .columns = {"engine", "server", "viewer", "FLIP (viewer)"},
                                .rows = {}};
    for (const auto& [camera, compared] : compared_) {
      metrics::ContactSheetRow row{.caption = fmt::format("camera {}", camera),
                                   .figures = {fmt::format("server SSIM {:.3f}", compared.server.ssim),
                                               fmt::format("PSNR {:.1f} dB", compared.server.psnr_db)},
                                   .pictures = {compared.engine, compared.drawn}};
      const auto viewer = viewer_known_.find(camera);
      const cv::Mat picture =
          viewer == viewer_known_.end() ? cv::Mat() : viewer_picture(viewer->second.probe_id, compared.engine.size());
      if (viewer != viewer_known_.end()) {
        const metrics::Quality& quality = viewer->second.quality;
        row.figures.push_back(fmt::format("viewer SSIM {:.3f}", quality.ssim));
        row.figures.push_back(fmt::format("PSNR {:.1f} dB", quality.psnr_db));
        row.figures.push_back(fmt::format("FLIP {:.3f}", quality.flip));
        if (is_stale(viewer->second.probe_id)) row.figures.emplace_back("(earlier round)");
      } else {
        row.figures.emplace_back("viewer: no answer");
      }
      cv::Mat map;
      if (!picture.empty()) static_cast<void>(metrics::flip(picture, compared.engine, 67.0, &map));
      row.pictures.push_back(picture);
      row.pictures.push_back(map.empty() ? map : metrics::colorize(map));
      sheet.rows.push_back(std::move(row));
    }
    metrics::write_png(options_.out / "contact_sheet.png", metrics::draw(sheet));
  }

  [[nodiscard]] bool is_stale(std::uint64_t probe_id) const { return probe_id < probes_.first_id(); }

  [[nodiscard]] Json make_summary(std::size_t gaussians) const {
    const PipelineState& state = watch_.state();
    ViewFigures server, viewer;
    for (const auto& [camera, compared] : compared_) server[camera] = compared.server;
    for (const auto& [camera, known] : viewer_known_) viewer[camera] = known.quality;
    const metrics::Quality at_server = summarize(server).mean;
    Json summary{{"first_picture_s", nullptr},
                 {"gaussians", gaussians},
                 {"ssim_server", rounded(at_server.ssim)},
                 {"psnr_server", rounded(at_server.psnr_db)},
                 {"flip_server", rounded(at_server.flip)},
                 {"ssim_viewer", nullptr},
                 {"psnr_viewer", nullptr},
                 {"flip_viewer", nullptr},
                 {"steps_per_s", rounded(steps_per_s())},
                 {"wire_mbps_mean", rounded(state.stream.wire_mbps_mean)},
                 {"wire_mbps_peak", rounded(state.stream.wire_mbps_peak)},
                 {"seconds", options_.seconds},
                 {"seed", options_.seed},
                 {"cameras", kHeldOutCameras}};
    if (!viewer.empty()) {
      const metrics::Quality at_viewer = summarize(viewer).mean;
      summary["ssim_viewer"] = rounded(at_viewer.ssim);
      summary["psnr_viewer"] = rounded(at_viewer.psnr_db);
      summary["flip_viewer"] = rounded(at_viewer.flip);
    }
    if (state.first_picture_ns != 0) {
      summary["first_picture_s"] = rounded(static_cast<double>(state.first_picture_ns - start_ns_) / 1e9);
    }
    const auto at_last =
        static_cast<std::size_t>(std::count_if(viewer_known_.begin(), viewer_known_.end(),
                                               [&](const auto& entry) { return !is_stale(entry.second.probe_id); }));
    if (server_.size() < kHeldOutCameras || at_last < kHeldOutCameras) {
      summary["note"] = fmt::format(
          "of {} held-out views, {} of the last round were compared at the server and {} at the viewer within {} s; "
          "the figures are of {} and {} views, older ones where the last did not come; see {}",
          kHeldOutCameras, server_.size(), at_last, kFinalTimeoutS, server.size(), viewer.size(), log_path());
    }
    return summary;
  }

  [[nodiscard]] std::string log_path() const { return (options_.out / "services.log").string(); }

  /// Newest comparison of a camera at the server.
  struct Compared {
    cv::Mat engine, drawn;
    metrics::Quality server;
  };
  /// Newest answer of the viewer about a camera.
  struct ViewerAnswer {
    std::uint64_t probe_id = 0;
    metrics::Quality quality;
  };

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
  ViewFigures server_;  ///< of this round
  std::map<std::size_t, Compared> compared_;
  std::map<std::size_t, ViewerAnswer> viewer_known_;
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
