#include "replay_evaluation.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <deque>
#include <filesystem>
#include <set>
#include <stdexcept>
#include <thread>

#include "eval_options.h"
#include "figures.h"
#include "launch_plan.h"
#include "metrics/metrics.h"
#include "pipeline_watch.h"
#include "player.h"
#include "probe_round.h"
#include "recorded_pace.h"
#include "scene_view.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;
constexpr std::chrono::milliseconds kPatience(20);
constexpr std::int64_t kMapPatienceNs = 1'000'000'000;  // as in the demo: depth maps come a moment later

struct ReplayOptions {
  CommonOptions common;
  std::string path, backend;
  double timeout_s = 60;
  bool free_running = false;
};

/// The launch file's services that work behind the capture-bridge, and the bus.
LaunchFile chain_of(const ReplayOptions& options) {
  const std::set<std::string> chain{"bus", "expander", "trainer", "relight"};
  LaunchFile file =
      read_launch_file(options.common.launch_file.empty() ? default_launch_file(options.common.default_launch)
                                                          : fs::path(options.common.launch_file));
  std::erase_if(file.services, [&](const LaunchService& service) { return !chain.contains(service.name); });
  for (LaunchService& service : file.services) {
    std::erase_if(service.after, [&](const auto& name) { return !chain.contains(name.value); });
  }
  set_backend(file, options.backend);
  return file;
}

class Replay {
 public:
  explicit Replay(const ReplayOptions& options)
      : options_(options),
        reader_(options.path),
        context_(connect_later(folder_.address())),
        watch_(context_),
        live_(context_),
        depths_(context_),
        probes_(context_, {std::string(topics::kCaptureProbe.name)}),
        view_(1),
        run_(plan_launch(chain_of(options), folder_.address(), program_directory()),
             fs::path(options.common.out) / "services.log") {
    depths_.keep(true);
  }

  Json run(const StopSignals& signals, const std::function<void(const std::string&)>& show) {
    const std::int64_t end_ns = bus::now_ns() + static_cast<std::int64_t>(options_.timeout_s * 1e9);
    while (!run_.all_running()) {
      if (bus::now_ns() > end_ns) throw std::runtime_error("the services did not start; see services.log");
      step(signals);
    }
    PlayState played;
    PaceKeeper pace(context_, options_.free_running ? RecordedPace({}) : RecordedPace(reader_));
    const bool paced = pace.known();
    std::atomic<bool> over = false;
    std::string failure;
    {
      const std::jthread player([&](const std::stop_token& stop) {
        try {
          PlayOptions play{.topics = {"capture/*", "scene/*", "viewer/pose"}};
          if (paced) {
            play.hold = [&](std::uint64_t log_time, const std::stop_token& end) { pace.hold(log_time, end); };
          }
          Player of_engine(reader_, folder_.address(), play);
          played = of_engine.run(stop, [](const PlayState&) {});
          if (paced) pace.finish(stop);
        } catch (const std::exception& error) {
          failure = error.what();
        }
        over = true;
      });
      while (!over || !waiting_.empty()) {
        step(signals);
        const auto& trainer = watch_.state().trainer;
        show(fmt::format("{} Gaussians, step {}, SSIM {:.4f}", trainer.gaussians, trainer.step,
                         figures_.empty() ? 0 : summarize(last_round(figures_)).mean.ssim));
      }
    }
    if (!failure.empty()) throw std::runtime_error(failure);
    // What the pace has heard the watch may not have heard yet.
    const std::int64_t heard_by_ns = bus::now_ns() + kMapPatienceNs;
    while (paced && watch_.state().trainer.step < pace.recorded_steps() && bus::now_ns() < heard_by_ns) step(signals);
    if (figures_.empty()) throw std::runtime_error("no capture/probe in the recording could be compared");
    const FigureSummary summary = summarize(last_round(figures_));
    const auto& trainer = watch_.state().trainer;
    return {{"recording", options_.path},
            {"messages", played.messages},
            {"most_late_s", rounded(static_cast<double>(played.late_ns) / 1e9)},
            {"recorded_steps", pace.recorded_steps()},
            {"steps_given_up", pace.given_up()},
            {"pictures", figures_.size()},
            {"last_round", last_round(figures_).size()},
            {"without_maps", without_maps_},
            {"unpaired_views", trainer.unpaired_views},
            {"gaussians", trainer.gaussians},
            {"steps", trainer.step},
            {"steps_per_s", rounded(trainer.steps_per_s)},
            {"ssim", rounded(summary.mean.ssim)},
            {"psnr", rounded(finite_psnr(summary.mean.psnr_db))},
            {"flip", rounded(summary.mean.flip)}};
  }

 private:
  struct Waiting {
    ProbePicture picture;
    std::int64_t since_ns;
    std::optional<SceneLights> lights;
  };

  void step(const StopSignals& signals) {
    run_.check();
    if (signals.stop().stop_requested()) throw std::runtime_error("interrupted");
    watch_.poll(kPatience);
    live_.poll(std::chrono::milliseconds(0));
    while (const auto message = probes_.receive(std::chrono::milliseconds(0))) {
      auto picture = to_probe_picture(*message);
      if (picture) waiting_.push_back({std::move(*picture), bus::now_ns(), std::nullopt});
    }
    for (Waiting& waiting : waiting_) {
      if (!waiting.lights) waiting.lights = depths_.find(waiting.picture.scene);
    }
    while (!waiting_.empty() && compare(waiting_.front())) waiting_.pop_front();
  }

  /// False while its depth maps or the model have not come.
  bool compare(const Waiting& waiting) {
    const bool late = bus::now_ns() - waiting.since_ns > kMapPatienceNs;
    if (!waiting.lights && !late) return false;
    const auto drawn =
        view_.render(live_, waiting.picture.camera, waiting.picture.scene, waiting.lights ? &*waiting.lights : nullptr);
    if (!drawn) return late;
    if (!waiting.lights) ++without_maps_;
    figures_[waiting.picture.probe_id] = metrics::compare(*drawn, waiting.picture.picture);
    return true;
  }

  const ReplayOptions& options_;
  mcap::Reader reader_;
  PrivateBusFolder folder_;
  std::shared_ptr<bus::Context> context_;
  PipelineWatch watch_;
  LiveScene live_;
  LightDepths depths_;
  bus::Subscriber probes_;
  SceneView view_;
  std::deque<Waiting> waiting_;
  ViewFigures figures_;           // by probe id
  std::size_t without_maps_ = 0;  // pictures that were drawn with the model's own visibility
  SupervisedRun run_;
};

}  // namespace

void add_replay_verb(CLI::App& eval, Action& action) {
  auto options = std::make_shared<ReplayOptions>();
  options->common.default_launch = "demo.yaml";
  CLI::App* verb = eval.add_subcommand(
      "replay", "Train on a recording, without an engine, and compare with the held-out pictures in it");
  verb->add_option("file", options->path, "recording (.mcap) of a demo, from before its first picture")->required();
  verb->add_option("--launch", options->common.launch_file,
                   "launch file whose bus, expander, trainer and relight are used (default: launch/demo.yaml)");
  verb->add_flag(
      "--free", options->free_running,
      "let trainer and expander work as fast as this machine does (default: the trainer takes the steps that "
      "were recorded, whatever the load)");
  verb->add_option("--timeout", options->timeout_s, "longest wait for the services, s")->check(CLI::PositiveNumber);
  verb->add_option("--out", options->common.out, "folder for what is written");
  verb->add_flag("--json", options->common.json, "print the result as one line of JSON");
  add_backend_option(*verb, options->backend);
  verb->callback([options, &action] {
    action = [options] {
      fs::create_directories(options->common.out);
      return evaluate(options->common, "summary.json, services.log", [&](const StopSignals& signals, auto show) {
        Json summary = Replay(*options).run(signals, show);
        write_text((fs::path(options->common.out) / "summary.json").string(), json_text(summary, 2) + "\n");
        return summary;
      });
    };
  });
}

}  // namespace splatbus::cli
