#include "fixed_evaluation.h"

#include <fmt/format.h>

#include <stdexcept>
#include <vector>

#include "bus/publisher.h"
#include "launch_plan.h"
#include "live_scene.h"
#include "metrics/contact_sheet.h"
#include "metrics/image_io.h"
#include "pipeline_watch.h"
#include "probe_round.h"
#include "schema_json.h"
#include "supervised_run.h"
#include "verbs.h"
#include "wire/system_generated.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr float kHeldOutTurnDegrees = 7;
constexpr std::int64_t kRepeatNs = 3'000'000'000;  ///< what was asked for and has not come is asked for again

class FixedEvaluation {
 public:
  FixedEvaluation(const FixedEvaluationOptions& options, const StopSignals& signals,
                  const std::function<void(const std::string&)>& show_state)
      : options_(options),
        signals_(signals),
        show_state_(show_state),
        plan_(plan_evaluation(options.setup, folder_.address(), true)),
        context_(connect(folder_.address())),
        watch_(context_),
        live_(context_),
        start_(context_, options.setup.enough_gaussians()),
        probes_(
            context_,
            circle_cameras({.count = options.views, .size = options.setup.size, .phase_degrees = kHeldOutTurnDegrees})),
        publisher_(context_),
        view_(own_backend(options.setup.backend), 0),
        run_(plan_, options.setup.out / "services.log") {}

  Json run(const std::function<void(const FixedEvaluationProgress&)>& show_progress) {
    prepare();
    std::string csv = kCsvHeader;
    ViewFigures figures;
    for (int iteration = options_.every;; iteration += options_.every) {
      const int step = std::min(iteration, options_.iterations);
      train_until(static_cast<std::uint64_t>(step));
      figures = evaluate();
      const auto& trainer = watch_.state().trainer;
      const FixedEvaluationProgress progress{.iteration = static_cast<std::uint64_t>(step),
                                             .gaussians = trainer.gaussians,
                                             .optimizer_s = trainer.optimizer_s,
                                             .steps_per_s = rate(static_cast<double>(trainer.step)),
                                             .figures = summarize(figures)};
      csv += csv_rows(progress.iteration, progress.optimizer_s, figures);
      write_text(options_.setup.out / "figures.csv", csv);
      evaluations_.push_back(progress);
      show_progress(progress);
      if (step == options_.iterations) break;
    }
    write_contact_sheet(figures);
    Json summary = make_summary(figures);
    write_text(options_.setup.out / "summary.json", json_text(summary, 2) + "\n");
    run_.stop();
    return summary;
  }

 private:
  /// Until every camera's picture is at the trainer, every sample in the model, and the engine's held-out pictures
  /// here.
  void prepare() {
    probes_.begin();
    std::int64_t asked_ns = bus::now_ns();
    const auto ready = [&] {
      if (!probes_.complete() && bus::now_ns() - asked_ns > kRepeatNs) {
        for (std::size_t i = 0; i < probes_.cameras().size(); ++i) {
          if (!probes_.pictures().contains(i)) probes_.ask_again(i);
        }
        asked_ns = bus::now_ns();
      }
      const PipelineState& state = watch_.state();
      return probes_.complete() &&
             state.trainer.ready_references >= static_cast<std::uint32_t>(options_.setup.cameras) &&
             state.trainer.ready_inputs >= static_cast<std::uint32_t>(options_.setup.input_cameras) &&
             state.grid.rounds >= 1 && state.grid.batches_pending == 0 && live_.published() &&
             live_.published()->count > 0 && state.visibility_generation == live_.published()->generation;
    };
    wait_until("the services and their first pictures", ready, [&] {
      const PipelineState& state = watch_.state();
      return fmt::format("references {}/{}, inputs {}/{}, held-out views {}/{}, {} Gaussians, {} batches pending{}",
                         state.trainer.ready_references, options_.setup.cameras, state.trainer.ready_inputs,
                         options_.setup.input_cameras, probes_.pictures().size(), options_.views,
                         state.trainer.gaussians, state.grid.batches_pending,
                         state.visibility_generation == 0 ? ", no light visibility" : "");
    });
  }

  void train_until(std::uint64_t step) {
    std::int64_t asked_ns = 0;
    const auto ready = [&] {
      if (bus::now_ns() - asked_ns > kRepeatNs) {
        send_control(step);
        asked_ns = bus::now_ns();
      }
      return watch_.state().trainer.step >= step;
    };
    wait_until(fmt::format("step {}", step), ready, [&] {
      const auto& trainer = watch_.state().trainer;
      return fmt::format("step {}/{}, {:.1f} steps/s, {} Gaussians, loss {:.4f}", trainer.step, options_.iterations,
                         trainer.steps_per_s, trainer.gaussians, trainer.loss);
    });
    if (watch_.state().trainer.step != step) {
      throw std::runtime_error(
          fmt::format("the trainer stopped at step {} instead of {}", watch_.state().trainer.step, step));
    }
  }

  void send_control(std::uint64_t step) {
    publisher_.publish(topics::control("control/trainer"), [&](auto& builder, auto header) {
      const std::vector changes{
          wire::CreateKeyValueDirect(builder, "run_until", std::to_string(step).c_str()),
          wire::CreateKeyValueDirect(builder, "paused", "false"),
      };
      return wire::CreateControl(builder, header, builder.CreateVector(changes));
    });
  }

  ViewFigures evaluate() {
    ViewFigures figures;
    for (const auto& [index, probe] : probes_.pictures()) {
      std::optional<cv::Mat> picture;
      wait_until(
          "a model to draw",
          [&, &held_out = probe] {
            return (picture = view_.render(live_, held_out.camera, held_out.scene)).has_value();
          },
          [] { return std::string("drawing held-out views"); });
      figures[index] = metrics::compare(*picture, probe.picture);
      drawn_[index] = *picture;
    }
    return figures;
  }

  void write_contact_sheet(const ViewFigures& figures) {
    metrics::ContactSheet sheet{
        .title = fmt::format("{} reference cameras of {}x{}, {} iterations, held-out views", options_.setup.cameras,
                             options_.setup.size, options_.setup.size, options_.iterations),
        .columns = {"engine", "server", "FLIP"},
        .rows = {},
        .picture_height = options_.setup.size};
    for (const auto& [index, probe] : probes_.pictures()) {
      const metrics::Quality& quality = figures.at(index);
      cv::Mat map;
      static_cast<void>(metrics::flip(drawn_.at(index), probe.picture, 67.0, &map));
      sheet.rows.push_back(
          {.caption = fmt::format("view {}", index),
           .figures = {fmt::format("SSIM {:.3f}", quality.ssim), fmt::format("PSNR {:.1f}", quality.psnr_db),
                       fmt::format("FLIP {:.3f}", quality.flip)},
           .pictures = {probe.picture, drawn_.at(index), metrics::colorize(map)}});
    }
    metrics::write_png(options_.setup.out / "contact_sheet.png", metrics::draw(sheet));
  }

  [[nodiscard]] double rate(double count) const {
    const double seconds = watch_.state().trainer.optimizer_s;
    return seconds > 0 ? count / seconds : 0;
  }

  [[nodiscard]] Json make_summary(const ViewFigures& figures) const {
    const FigureSummary summary = summarize(figures);
    const auto& trainer = watch_.state().trainer;
    Json result{{"gaussians", trainer.gaussians},
                {"iterations", trainer.step},
                {"optimizer_s", rounded(trainer.optimizer_s)},
                {"ssim_mean", rounded(summary.mean.ssim)},
                {"ssim_min", rounded(summary.ssim_min)},
                {"psnr_mean", rounded(summary.mean.psnr_db)},
                {"flip_mean", rounded(summary.mean.flip)},
                {"flip_max", rounded(summary.flip_max)},
                {"steps_per_s", rounded(rate(static_cast<double>(trainer.step)))},
                {"views_per_s", rounded(rate(static_cast<double>(trainer.views)))},
                {"host_copied_bytes", trainer.host_copied_bytes},
                {"host_copied_bytes_by_service", host_copied_bytes(run_.status())},
                {"evaluations", Json::array()}};
    for (const FixedEvaluationProgress& at : evaluations_) {
      result["evaluations"].push_back({{"iteration", at.iteration},
                                       {"optimizer_s", rounded(at.optimizer_s)},
                                       {"ssim_mean", rounded(at.figures.mean.ssim)},
                                       {"ssim_min", rounded(at.figures.ssim_min)},
                                       {"flip_mean", rounded(at.figures.mean.flip)},
                                       {"flip_max", rounded(at.figures.flip_max)}});
    }
    result.update(start_.summary());
    return result;
  }

  void wait_until(const std::string& what, const std::function<bool()>& condition,
                  const std::function<std::string()>& describe) {
    const std::int64_t end_ns = bus::now_ns() + static_cast<std::int64_t>(options_.setup.timeout_s * 1e9);
    std::int64_t shown_ns = 0;
    while (!condition()) {
      run_.check();
      if (signals_.stop().stop_requested()) throw std::runtime_error("interrupted while waiting for " + what);
      if (bus::now_ns() > end_ns) {
        throw std::runtime_error(fmt::format("{} did not come within {} s ({}); see {}", what, options_.setup.timeout_s,
                                             describe(), (options_.setup.out / "services.log").string()));
      }
      watch_.poll(std::chrono::milliseconds(20));
      live_.poll(std::chrono::milliseconds(0));
      start_.poll(std::chrono::milliseconds(0));
      probes_.poll(std::chrono::milliseconds(0), [](std::size_t, const ProbePicture&) {});
      if (bus::now_ns() - shown_ns > 1'000'000'000) {
        show_state_(describe());
        shown_ns = bus::now_ns();
      }
    }
  }

  const FixedEvaluationOptions& options_;
  const StopSignals& signals_;
  const std::function<void(const std::string&)>& show_state_;
  PrivateBusFolder folder_;
  LaunchPlan plan_;
  std::shared_ptr<bus::Context> context_;
  PipelineWatch watch_;
  LiveScene live_;
  StartWatch start_;
  ProbeRounds probes_;
  bus::Publisher publisher_;
  ServerView view_;
  std::map<std::size_t, cv::Mat> drawn_;
  std::vector<FixedEvaluationProgress> evaluations_;
  SupervisedRun run_;
};

}  // namespace

Json run_fixed_evaluation(const FixedEvaluationOptions& options, const StopSignals& signals,
                          const std::function<void(const std::string&)>& show_state,
                          const std::function<void(const FixedEvaluationProgress&)>& show_progress) {
  fs::create_directories(options.setup.out);
  return FixedEvaluation(options, signals, show_state).run(show_progress);
}

}  // namespace splatbus::cli
