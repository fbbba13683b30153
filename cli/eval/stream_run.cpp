#include "stream_run.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>
#include <utility>

#include "light_followers.h"
#include "linked_viewer.h"
#include "private_pipeline.h"
#include "probe_round.h"
#include "process_memory.h"
#include "scene_view.h"
#include "tcp_relay.h"

namespace splatbus::cli {

namespace {

constexpr std::int64_t kSecond = 1'000'000'000;
constexpr std::int64_t kRoundPatienceNs = 8 * kSecond;       // then the pictures that did not come are given up
constexpr std::int64_t kMapPatienceNs = kSecond;             // the lights' depth comes a moment after the picture
constexpr std::int64_t kVisibilityPatienceNs = 150'000'000;  // and what viewers see of them, some 20 times a second
constexpr double kFresh_s = 1;                               // a picture that may be compared again: the scene goes on
constexpr double kMostStart_s = 120, kMostJoin_s = 20, kMostFollow_s = 60, kMostRecovery_s = 30;

class StreamRun {
 public:
  StreamRun(const StreamRunOptions& options, const std::string& name, const StopSignals& signals,
            const std::function<void(const std::string&)>& show_state)
      : options_(options),
        show_state_(show_state),
        pipeline_(signals, options.setup.out / fmt::format("services_{}.log", name)),
        port_(free_loopback_port()),
        link_(options.shape.empty() && options.cut_s == 0 ? nullptr : make_link(options.link, options.shape, port_)),
        plan_(plan_stream(options, pipeline_.address(), port_)),
        depths_(pipeline_.context()),
        probes_(pipeline_.context(), plan_.held_out),
        view_(1),
        followers_(local_endpoint()),
        begun_ns_(bus::now_ns()) {
    pipeline_.start(plan_.launch);
    viewer_.emplace(endpoint(), "viewer");
    results_.link = link_ ? link_->text() : "none: the same machine, ipc";
    results_.mbps = options.shape.mbps;
  }

  StreamResults run() {
    start();
    for (const std::size_t viewers : options_.viewers) stage(viewers);
    results_.end_s = time_s();
    note_viewer();
    join();
    results_.gaussians = pipeline_.state().trainer.gaussians;
    pipeline_.stop();
    if (results_.samples.empty()) throw std::runtime_error("no picture was compared; see " + pipeline_.log().string());
    return std::move(results_);
  }

 private:
  /// A picture of the engine, and what it is compared under.
  struct Compared {
    ProbePicture probe;
    std::optional<SceneLights> lights;
  };
  struct Round {
    std::int64_t asked_ns = 0;
    bool hurried = false;  ///< of one camera, as soon as the last was done
    bool settled = false;
    std::map<std::size_t, Compared> pictures;
    std::map<std::size_t, std::int64_t> came_ns;  ///< by camera
    double ssim_server = 0, ssim_viewer = 0;      ///< sums over pictures
  };

  [[nodiscard]] std::string local_endpoint() const {
    return fmt::format("ipc://{}/streamer", pipeline_.folder().string());
  }
  [[nodiscard]] std::string endpoint() const { return link_ ? link_->endpoint() : local_endpoint(); }

  [[nodiscard]] double seconds_since(std::int64_t ns) const { return static_cast<double>(bus::now_ns() - ns) / 1e9; }
  [[nodiscard]] double time_s() const { return results_.begin_ns == 0 ? 0 : seconds_since(results_.begin_ns); }

  /// Until the viewer shows something.
  void start() {
    while (viewer_->status().first_ns == 0) {
      if (seconds_since(begun_ns_) > kMostStart_s) {
        throw std::runtime_error(
            fmt::format("the viewer had no Gaussian within {} s; see {}", kMostStart_s, pipeline_.log().string()));
      }
      step(false);
    }
    results_.begin_ns = bus::now_ns();
    shown_ = &*viewer_;
  }

  void stage(std::size_t viewers) {
    followers_.grow_to(viewers - 1);
    const std::int64_t since_ns = bus::now_ns();
    ViewersStage stage{.viewers = viewers};
    const auto count_whole = [&] { return stage.whole = std::max(stage.whole, followers_.whole()); };
    while (count_whole() < viewers - 1 && seconds_since(since_ns) < kMostFollow_s) step(true);
    stage.from_s = time_s();
    const double cut_at_s = stage.from_s + options_.seconds / 2;
    stage.to_s = stage.from_s + options_.seconds;
    while (time_s() < stage.to_s) {
      if (options_.cut_s > 0 && !cut_ && time_s() >= cut_at_s) begin_cut();
      step(true);
      count_whole();
    }
    if (options_.viewers.size() > 1) results_.stages.push_back(stage);
    while (cut_ && !results_.cut_whole_s && seconds_since(cut_->to_ns) < kMostRecovery_s) step(true);
  }

  void begin_cut() {
    note_usual_gap();
    cut_ = link_->cut(options_.cut_s);
    results_.cut = TimeWindow{.from_s = static_cast<double>(cut_->from_ns - results_.begin_ns) / 1e9,
                              .to_s = static_cast<double>(cut_->to_ns - results_.begin_ns) / 1e9};
  }

  /// Of the last half of the pictures: the model is there by then.
  void note_usual_gap() {
    std::vector<double> gaps;
    for (std::size_t i = results_.samples.size() / 2; i < results_.samples.size(); ++i) {
      gaps.push_back(results_.samples[i].gap());
    }
    usual_gap_ = median(std::move(gaps)).value_or(0);
  }

  [[nodiscard]] bool recovers() const { return cut_ && !results_.cut_whole_s && bus::now_ns() >= cut_->to_ns; }

  void step(bool new_rounds) {
    if (link_) link_->maintain();
    pipeline_.poll(std::chrono::milliseconds(10));
    probes_.poll(std::chrono::milliseconds(0), [](std::size_t, const ProbePicture&) {});
    if (viewer_) viewer_->look(plan_.viewer(time_s()));
    compare_what_has_come();
    if (new_rounds) begin_round(!viewer_ || recovers());
    watch_recovery();
    if (seconds_since(sampled_ns_) > 1) note_server();
  }

  void begin_round(bool hurried) {
    const bool done = !round_ || round_->settled;
    const double wait_s = !done ? static_cast<double>(kRoundPatienceNs) / 1e9 : hurried ? 0 : options_.every_s;
    if (round_ && seconds_since(round_->asked_ns) < wait_s) return;
    depths_.keep(true);
    if (plan_.held_out.empty()) {
      Camera camera = plan_.viewer(viewer_ ? time_s() : results_.end_s);
      camera.role = CameraRole::Probe;
      probes_.begin(std::vector{camera});
    } else {
      probes_.begin(hurried ? 1 : plan_.held_out.size());
    }
    round_ = Round{.asked_ns = bus::now_ns(), .hurried = hurried};
  }

  void compare_what_has_come() {
    if (!round_ || round_->settled || shown_ == nullptr) return;
    for (const auto& [index, probe] : probes_.pictures()) round_->came_ns.try_emplace(index, bus::now_ns());
    for (const auto& [index, probe] : probes_.pictures()) {
      if (round_->pictures.contains(index)) continue;
      std::optional<SceneLights> lights = depths_.find(probe.scene);
      if (!lights && bus::now_ns() - round_->asked_ns < kMapPatienceNs) return;
      const bool lit = shown_->status().visibility_version >= probe.scene.version;
      if (!lit && bus::now_ns() - round_->came_ns.at(index) < kVisibilityPatienceNs) return;
      const Compared compared{.probe = probe, .lights = std::move(lights)};
      const auto figures = compare(compared);
      if (!figures) return;
      round_->ssim_server += figures->first;
      round_->ssim_viewer += figures->second;
      round_->pictures.emplace(index, compared);
    }
    if (!probes_.complete()) return;
    depths_.keep(false);
    round_->settled = true;
    last_ns_ = bus::now_ns();
    const auto count = static_cast<double>(round_->pictures.size());
    results_.samples.push_back(
        {.time_s = time_s(), .ssim_server = round_->ssim_server / count, .ssim_viewer = round_->ssim_viewer / count});
    last_ = round_->pictures.begin()->second;
  }

  /// SSIM of what the server and the viewer show now of what the engine showed; nullopt while one of them cannot say.
  [[nodiscard]] std::optional<std::pair<double, double>> compare(const Compared& compared) {
    const ProbePicture& probe = compared.probe;
    const auto server =
        view_.render(pipeline_.live(), probe.camera, probe.scene, compared.lights ? &*compared.lights : nullptr);
    if (!server) return {};
    const auto drawn = shown_->draw(probe.camera, probe.scene);
    if (!drawn) return {};
    return std::pair{metrics::compare(*server, probe.picture).ssim, metrics::compare(*drawn, probe.picture).ssim};
  }

  /// By the newest picture, beyond what is usual; nullopt while there is none of this moment.
  [[nodiscard]] std::optional<double> gap_now() {
    if (!last_ || seconds_since(last_ns_) > kFresh_s) return {};
    const auto figures = compare(*last_);
    if (!figures) return {};
    return figures->first - figures->second - usual_gap_;
  }

  /// After a cut, as often as pictures can be drawn.
  void watch_recovery() {
    if (!recovers() || !viewer_) return;
    if (!results_.cut_fresh_s) {
      const std::vector<Delivery> deliveries = viewer_->deliveries();
      const auto fresh =
          std::ranges::find_if(deliveries, [&](const Delivery& delivery) { return delivery.encoded_ns > cut_->to_ns; });
      if (fresh == deliveries.end()) return;
      results_.cut_fresh_s = static_cast<double>(fresh->there_ns - cut_->to_ns) / 1e9;
    }
    const auto gap = gap_now();
    if (gap && *gap <= kCloseGap && viewer_->status().whole) results_.cut_whole_s = seconds_since(cut_->to_ns);
  }

  void note_server() {
    for (const ProcessStatus& process : pipeline_.processes()) {
      if (process.name != "streamer" || process.pid == 0) continue;
      const auto tick_ms = process.counters.find("tick_ms");
      const auto resident = resident_bytes(process.pid);
      const auto processor_s = processor_seconds(process.pid);
      if (tick_ms != process.counters.end() && resident && processor_s && processor_s_ && sampled_ns_ != 0) {
        results_.server.push_back({.time_s = time_s(),
                                   .viewers = followers_.count() + 1,
                                   .tick_ms = tick_ms->second,
                                   .cpu_share = (*processor_s - *processor_s_) / seconds_since(sampled_ns_),
                                   .resident_mb = static_cast<double>(*resident) / 1e6});
      }
      processor_s_ = processor_s;
    }
    sampled_ns_ = bus::now_ns();
    show_state_(state());
  }

  [[nodiscard]] std::string state() const {
    const PipelineState& pipeline = pipeline_.state();
    std::string text = fmt::format("{:.0f} s  {} Gaussians  {:.1f} steps/s  {:.2f} Mbit/s to {} viewers", time_s(),
                                   pipeline.trainer.gaussians, pipeline.trainer.steps_per_s, pipeline.stream.wire_mbps,
                                   pipeline.stream.viewers);
    if (!results_.samples.empty()) {
      const StreamSample& sample = results_.samples.back();
      text += fmt::format("  SSIM server {:.4f} viewer {:.4f}", sample.ssim_server, sample.ssim_viewer);
    }
    return text;
  }

  void note_viewer() {
    const LinkedViewer::Status status = viewer_->status();
    if (status.whole_ns != 0) {
      results_.whole_s = std::max(0.0, static_cast<double>(status.whole_ns - results_.begin_ns) / 1e9);
    }
    results_.arrivals = viewer_->arrivals();
    results_.deliveries = viewer_->deliveries();
    results_.tick_hz = status.tick_hz;
    results_.refused = status.refused;
    shown_ = nullptr;
    viewer_.reset();
  }

  void join() {
    note_usual_gap();
    LinkedViewer joiner(endpoint(), "joiner");
    joiner.look(plan_.held_out.empty() ? plan_.viewer(results_.end_s) : plan_.held_out.front());
    shown_ = &joiner;
    const std::int64_t begun_ns = joiner.status().begun_ns;
    const auto since_start = [&](std::int64_t ns) { return static_cast<double>(ns - begun_ns) / 1e9; };
    StreamJoin& join = results_.join;
    while (seconds_since(begun_ns) < kMostJoin_s && !(join.whole_s && join.close_s)) {
      step(true);
      const LinkedViewer::Status status = joiner.status();
      if (status.first_ns != 0) join.first_s = since_start(status.first_ns);
      if (status.whole_ns != 0) join.whole_s = since_start(status.whole_ns);
      const auto gap = gap_now();
      if (!gap) continue;
      const double now_s = seconds_since(begun_ns);
      if (*gap <= kNearGap && !join.near_s) join.near_s = now_s;
      if (*gap <= kCloseGap && !join.close_s) join.close_s = now_s;
    }
    shown_ = nullptr;
  }

  const StreamRunOptions& options_;
  const std::function<void(const std::string&)>& show_state_;
  PrivatePipeline pipeline_;
  std::uint16_t port_;
  std::unique_ptr<NetworkLink> link_;  ///< null: none
  StreamPlan plan_;
  LightDepths depths_;
  ProbeRounds probes_;
  SceneView view_;
  LightFollowers followers_;
  std::optional<Round> round_;
  std::optional<Compared> last_;  ///< the newest, of last_ns_
  std::int64_t last_ns_ = 0;
  std::optional<LinkCut> cut_;
  double usual_gap_ = 0;
  std::optional<double> processor_s_;
  StreamResults results_;
  std::int64_t begun_ns_, sampled_ns_ = 0;
  std::optional<LinkedViewer> viewer_;
  LinkedViewer* shown_ = nullptr;  ///< whose pictures are compared
};

}  // namespace

StreamResults run_stream(const StreamRunOptions& options, const std::string& name, const StopSignals& signals,
                         const std::function<void(const std::string&)>& show_state) {
  return StreamRun(options, name, signals, show_state).run();
}

}  // namespace splatbus::cli
