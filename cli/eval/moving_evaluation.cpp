#include "moving_evaluation.h"

#include <fmt/format.h>

#include <cmath>
#include <glm/gtc/constants.hpp>
#include <limits>
#include <stdexcept>
#include <utility>

#include "figures.h"
#include "live_scene.h"
#include "metrics/image_io.h"
#include "metrics/plot.h"
#include "private_pipeline.h"
#include "probe_round.h"
#include "schema_json.h"
#include "verbs.h"
#include "viewer_watch.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::json;

constexpr std::int64_t kSecond = 1'000'000'000;
constexpr std::int64_t kRoundNs = kSecond / 2;
constexpr std::int64_t kRoundPatienceNs = 2 * kSecond;
constexpr std::int64_t kAnswerPatienceNs = 3 * kSecond;  // for the viewer's last answer
constexpr double kMostStart_s = 60;                      // until there is a model and a viewer
constexpr const char* kViewer = "viewer";
constexpr const char* kHeader = "run,time_s,angle_deg,ssim_server,flip_server,ssim_viewer,flip_viewer\n";

enum class Rig { Fixed, Moving };

const char* name_of(Rig rig) {
  return rig == Rig::Fixed ? "fixed" : "rig";
}

LaunchPlan make_plan(const MovingOptions& options, Rig rig, const bus::Address& address) {
  const Circle circle{.count = options.setup.cameras, .size = options.setup.size};
  EvaluationSetup setup = options.setup;
  if (rig == Rig::Moving) setup.cameras = options.rig_cameras;
  Settings settings{
      {"viewer.path", "orbit"},
      {"viewer.radius_m", fmt::format("{}", circle.radius_m)},
      {"viewer.height_m", fmt::format("{}", circle.height_m)},
      {"viewer.fov_degrees", fmt::format("{}", circle.fov_degrees)},
      {"viewer.period_s", fmt::format("{}", options.period_s)},
      {"viewer.width", std::to_string(setup.size)},
      {"viewer.height", std::to_string(setup.size)},
  };
  if (rig == Rig::Moving) settings.emplace_back("capture-bridge.reference_rig", "follow");
  return plan_evaluation(setup, address, false, [&](LaunchFile& file) { apply_settings(settings, file); });
}

class MovingRun {
 public:
  MovingRun(const MovingOptions& options, Rig rig, const StopSignals& signals,
            const std::function<void(const std::string&)>& show_state)
      : options_(options),
        rig_(rig),
        show_state_(show_state),
        pipeline_(signals, options.setup.out / fmt::format("services_{}.log", name_of(rig))),
        viewers_(pipeline_.context()),
        probes_(pipeline_.context(), {}),
        view_(own_backend(options.setup.backend), 1),
        begun_ns_(bus::now_ns()) {
    pipeline_.start(make_plan(options, rig, pipeline_.address()));
    results_.window = judged_window(options.seconds);
  }

  MovingResults run() {
    while (time_s() < options_.seconds) step(true);
    const std::int64_t end_ns = bus::now_ns() + kAnswerPatienceNs;
    while (bus::now_ns() < end_ns && (!probes_.complete() || !answered())) step(false);
    const PipelineState& state = pipeline_.state();
    results_.steps_per_s = state.trainer.steps_per_s;
    results_.gaussians = state.trainer.gaussians;
    results_.wire_mbps_mean = state.stream.wire_mbps_mean;
    pipeline_.stop();
    for (std::size_t i = 0; i < results_.samples.size(); ++i) {
      if (const auto* answer = viewers_.answer(kViewer, probe_ids_[i])) results_.samples[i].viewer = answer->quality;
    }
    if (results_.samples.empty()) throw std::runtime_error("no picture was compared; see " + pipeline_.log().string());
    return std::move(results_);
  }

 private:
  /// Since there has been a model and a viewer.
  [[nodiscard]] double time_s() const {
    return first_round_ns_ == 0 ? 0 : static_cast<double>(bus::now_ns() - first_round_ns_) / 1e9;
  }

  [[nodiscard]] bool answered() const {
    return !probe_ids_.empty() && viewers_.answer(kViewer, probe_ids_.back()) != nullptr;
  }

  void step(bool new_rounds) {
    const std::int64_t now_ns = bus::now_ns();
    if (first_round_ns_ == 0 && static_cast<double>(now_ns - begun_ns_) / 1e9 > kMostStart_s) {
      throw std::runtime_error(
          fmt::format("neither a model nor a viewer came within {} s; see {}", kMostStart_s, pipeline_.log().string()));
    }
    const ViewerWatch::Pose* pose = viewers_.pose(kViewer);
    const bool done = probes_.first_id() == 0 || probes_.complete();
    if (new_rounds && pose != nullptr && pipeline_.has_gaussians() &&
        now_ns - asked_ns_ > (done ? kRoundNs : kRoundPatienceNs)) {
      if (first_round_ns_ == 0) first_round_ns_ = now_ns;
      probes_.begin(std::vector{pose->camera});
      asked_ns_ = now_ns;
    }
    pipeline_.poll(std::chrono::milliseconds(10));
    viewers_.poll(std::chrono::milliseconds(0));
    probes_.poll(std::chrono::milliseconds(0), [this](std::size_t, const ProbePicture& probe) { compare(probe); });
    if (now_ns - shown_ns_ < kSecond) return;
    shown_ns_ = now_ns;
    const auto& trainer = pipeline_.state().trainer;
    show_state_(fmt::format("{}: {:.0f}/{:.0f} s  {} Gaussians  {:.1f} steps/s  {} pictures", name_of(rig_), time_s(),
                            options_.seconds, trainer.gaussians, trainer.steps_per_s, results_.samples.size()));
  }

  void compare(const ProbePicture& probe) {
    // Its structure may change while it is drawn.
    std::optional<cv::Mat> drawn;
    for (int attempt = 0; attempt < 3 && !drawn; ++attempt) {
      pipeline_.live().poll(std::chrono::milliseconds(0));
      drawn = view_.render(pipeline_.live(), probe.camera, probe.scene);
    }
    if (!drawn) return;
    const glm::vec3& eye = probe.camera.world_from_camera.translation;
    results_.samples.push_back({.time_s = static_cast<double>(asked_ns_ - first_round_ns_) / 1e9,
                                .angle_deg = glm::degrees(std::atan2(eye.z, eye.x)),
                                .server = metrics::compare(*drawn, probe.picture),
                                .viewer = {}});
    probe_ids_.push_back(probe.probe_id);
  }

  const MovingOptions& options_;
  const Rig rig_;
  const std::function<void(const std::string&)>& show_state_;
  PrivatePipeline pipeline_;
  ViewerWatch viewers_;
  ProbeRounds probes_;
  ServerView view_;
  MovingResults results_;
  std::vector<std::uint64_t> probe_ids_;  ///< of the samples
  std::int64_t begun_ns_, first_round_ns_ = 0, asked_ns_ = 0, shown_ns_ = 0;
};

template <class Get>
std::vector<TimedFigure> series(const MovingResults& results, Get get) {
  std::vector<TimedFigure> figures;
  for (const MovingSample& sample : results.samples) {
    if (const std::optional<double> value = get(sample)) figures.push_back({sample.time_s, *value});
  }
  return figures;
}

auto at_server(double metrics::Quality::*member) {
  return [=](const MovingSample& sample) -> std::optional<double> { return sample.server.*member; };
}

auto at_viewer(double metrics::Quality::*member) {
  return [=](const MovingSample& sample) -> std::optional<double> {
    if (!sample.viewer) return {};
    return (*sample.viewer).*member;
  };
}

std::string csv_rows(const char* run, const MovingResults& results) {
  std::string rows;
  for (const MovingSample& sample : results.samples) {
    rows += fmt::format("{},{:.3f},{:.2f},{:.5f},{:.5f},", run, sample.time_s, sample.angle_deg, sample.server.ssim,
                        sample.server.flip);
    rows += sample.viewer ? fmt::format("{:.5f},{:.5f}\n", sample.viewer->ssim, sample.viewer->flip) : ",\n";
  }
  return rows;
}

void add_lines(const char* run, const MovingResults& results, metrics::Plot& plot) {
  const auto add = [&](const char* where, const std::vector<TimedFigure>& figures) {
    metrics::PlotLine line{.name = fmt::format("{}, {}", run, where)};
    for (const TimedFigure& figure : figures) {
      line.x.push_back(figure.time_s);
      line.y.push_back(figure.value);
    }
    plot.lines.push_back(std::move(line));
  };
  add("server", series(results, at_server(&metrics::Quality::ssim)));
  add("viewer", series(results, at_viewer(&metrics::Quality::ssim)));
}

}  // namespace

Json summarize_moving(const MovingResults& results) {
  const auto mean = [&](const auto& get) {
    const std::optional<double> value = mean_within(series(results, get), results.window);
    return value ? Json(rounded(*value)) : Json();
  };
  const std::optional<double> worst = worst_second(series(results, at_server(&metrics::Quality::ssim)), results.window);
  return {{"ssim_server", mean(at_server(&metrics::Quality::ssim))},
          {"flip_server", mean(at_server(&metrics::Quality::flip))},
          {"ssim_viewer", mean(at_viewer(&metrics::Quality::ssim))},
          {"flip_viewer", mean(at_viewer(&metrics::Quality::flip))},
          {"ssim_server_worst_second", worst ? Json(rounded(*worst)) : Json()},
          {"pictures", results.samples.size()},
          {"gaussians", results.gaussians},
          {"steps_per_s", rounded(results.steps_per_s)},
          {"wire_mbps_mean", rounded(results.wire_mbps_mean)}};
}

Json run_moving_evaluation(const MovingOptions& options, const StopSignals& signals,
                           const std::function<void(const std::string&)>& show_state) {
  const std::filesystem::path& out = options.setup.out;
  std::filesystem::create_directories(out);
  Json summary;
  std::string csv = kHeader;
  metrics::Plot plot{.title = "SSIM from where the viewer is", .x_label = "seconds", .y_from = 0.5};
  for (const Rig rig : {Rig::Fixed, Rig::Moving}) {
    const MovingResults results = MovingRun(options, rig, signals, show_state).run();
    csv += csv_rows(name_of(rig), results);
    add_lines(name_of(rig), results, plot);
    summary[name_of(rig)] = summarize_moving(results);
  }
  summary.update(Json(summary["rig"]));
  summary.update({{"seconds", options.seconds},
                  {"period_s", options.period_s},
                  {"cameras", options.setup.cameras},
                  {"rig_cameras", options.rig_cameras}});
  write_text(out / "figures.csv", csv);
  write_text(out / "summary.json", json_text(summary, 2) + "\n");
  metrics::write_png(out / "figures.png", metrics::draw({plot}));
  return summary;
}

}  // namespace splatbus::cli
