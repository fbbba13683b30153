#include "fixed_evaluation.h"

#include <fmt/format.h>

#include <stdexcept>
#include <vector>

#include "live_scene.h"
#include "metrics/contact_sheet.h"
#include "metrics/image_io.h"
#include "probe_round.h"
#include "schema_json.h"
#include "staged_training.h"
#include "verbs.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr float kHeldOutTurnDegrees = 7;

class FixedEvaluation {
 public:
  FixedEvaluation(const FixedEvaluationOptions& options, const StopSignals& signals,
                  const std::function<void(const std::string&)>& show_state)
      : options_(options),
        training_(
            options.setup,
            circle_cameras({.count = options.views, .size = options.setup.size, .phase_degrees = kHeldOutTurnDegrees}),
            signals, show_state),
        view_(own_backend(options.setup.backend), 0) {}

  Json run(const std::function<void(const FixedEvaluationProgress&)>& show_progress) {
    training_.prepare();
    std::string csv = kCsvHeader;
    ViewFigures figures;
    for (int iteration = options_.every;; iteration += options_.every) {
      const int step = std::min(iteration, options_.iterations);
      training_.train_until(static_cast<std::uint64_t>(step));
      figures = evaluate();
      const auto& trainer = training_.state().trainer;
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
    training_.stop();
    return summary;
  }

 private:
  ViewFigures evaluate() {
    ViewFigures figures;
    for (const auto& [index, probe] : training_.held_out().pictures()) {
      std::optional<cv::Mat> picture;
      training_.wait_until(
          "a model to draw",
          [&, &held_out = probe] {
            return (picture = view_.render(training_.live(), held_out.camera, held_out.scene)).has_value();
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
    for (const auto& [index, probe] : training_.held_out().pictures()) {
      const metrics::Quality& quality = figures.at(index);
      cv::Mat map;
      static_cast<void>(metrics::flip(drawn_.at(index), probe.picture, metrics::kFlipPixelsPerDegree, &map));
      sheet.rows.push_back(
          {.caption = fmt::format("view {}", index),
           .figures = {fmt::format("SSIM {:.3f}", quality.ssim), fmt::format("PSNR {:.1f}", quality.psnr_db),
                       fmt::format("FLIP {:.3f}", quality.flip)},
           .pictures = {probe.picture, drawn_.at(index), metrics::colorize(map)}});
    }
    metrics::write_png(options_.setup.out / "contact_sheet.png", metrics::draw(sheet));
  }

  [[nodiscard]] double rate(double count) const {
    const double seconds = training_.state().trainer.optimizer_s;
    return seconds > 0 ? count / seconds : 0;
  }

  [[nodiscard]] Json make_summary(const ViewFigures& figures) const {
    const FigureSummary summary = summarize(figures);
    const auto& trainer = training_.state().trainer;
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
                {"host_copied_bytes_by_service", host_copied_bytes(training_.processes())},
                {"evaluations", Json::array()}};
    for (const FixedEvaluationProgress& at : evaluations_) {
      result["evaluations"].push_back({{"iteration", at.iteration},
                                       {"optimizer_s", rounded(at.optimizer_s)},
                                       {"ssim_mean", rounded(at.figures.mean.ssim)},
                                       {"ssim_min", rounded(at.figures.ssim_min)},
                                       {"flip_mean", rounded(at.figures.mean.flip)},
                                       {"flip_max", rounded(at.figures.flip_max)}});
    }
    result.update(training_.start().summary());
    return result;
  }

  const FixedEvaluationOptions& options_;
  StagedTraining training_;
  ServerView view_;
  std::map<std::size_t, cv::Mat> drawn_;
  std::vector<FixedEvaluationProgress> evaluations_;
};

}  // namespace

Json run_fixed_evaluation(const FixedEvaluationOptions& options, const StopSignals& signals,
                          const std::function<void(const std::string&)>& show_state,
                          const std::function<void(const FixedEvaluationProgress&)>& show_progress) {
  fs::create_directories(options.setup.out);
  return FixedEvaluation(options, signals, show_state).run(show_progress);
}

}  // namespace splatbus::cli
