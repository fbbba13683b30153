#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>

#include "fixed_evaluation.h"
#include "launch_plan.h"
#include "schema_json.h"
#include "start_evaluation.h"
#include "terminal.h"
#include "verbs.h"

namespace splatbus::cli {

namespace {

struct EvalOptions {
  FixedEvaluationOptions fixed;
  std::string launch_file;
  std::string out = "out/eval";
  bool json = false;

  [[nodiscard]] EvaluationSetup setup() const {
    EvaluationSetup setup = fixed.setup;
    setup.launch_file =
        launch_file.empty() ? default_launch_file("eval_fixed.yaml") : std::filesystem::path(launch_file);
    setup.out = out;
    return setup;
  }
};

int evaluate_fixed(EvalOptions options) {
  options.fixed.setup = options.setup();
  const StopSignals signals;
  ProgressLine line;
  const auto show_progress = [&](const FixedEvaluationProgress& progress) {
    const FigureSummary& figures = progress.figures;
    if (options.json) {
      fmt::print("{}\n", json_text({{"iteration", progress.iteration},
                                    {"gaussians", progress.gaussians},
                                    {"optimizer_s", rounded(progress.optimizer_s)},
                                    {"steps_per_s", rounded(progress.steps_per_s)},
                                    {"ssim_mean", rounded(figures.mean.ssim)},
                                    {"psnr_mean", rounded(figures.mean.psnr_db)},
                                    {"flip_mean", rounded(figures.mean.flip)},
                                    {"flip_max", rounded(figures.flip_max)}}));
      std::fflush(stdout);
      return;
    }
    line.show(fmt::format(
        "iteration {}/{}  SSIM {:.4f} (least {:.4f})  PSNR {:.2f} dB  FLIP {:.4f} (most {:.4f})  {:.1f} steps/s",
        progress.iteration, options.fixed.iterations, figures.mean.ssim, figures.ssim_min, figures.mean.psnr_db,
        figures.mean.flip, figures.flip_max, progress.steps_per_s));
    line.finish();
  };
  const auto show_state = [&](const std::string& state) {
    if (!options.json) line.show(state);
  };
  const nlohmann::json summary = run_fixed_evaluation(options.fixed, signals, show_state, show_progress);
  line.finish();
  fmt::print("{}\n", json_text(summary, options.json ? -1 : 2));
  if (!options.json) fmt::print("{}: figures.csv, summary.json, contact_sheet.png\n", options.out);
  return 0;
}

int evaluate_start(const EvalOptions& options) {
  const StopSignals signals;
  ProgressLine line;
  const nlohmann::json summary = run_start_evaluation(options.setup(), signals, [&](const std::string& state) {
    if (!options.json) line.show(state);
  });
  line.finish();
  fmt::print("{}\n", json_text(summary, options.json ? -1 : 2));
  return 0;
}

void add_setup_options(CLI::App& verb, EvalOptions& options) {
  EvaluationSetup& setup = options.fixed.setup;
  verb.option_defaults()->always_capture_default();
  verb.add_option("--cameras", setup.cameras, "reference cameras")->check(CLI::Range(1, 64));
  verb.add_option("--size", setup.size, "their width and height, pixels")->check(CLI::Range(32, 2048));
  verb.add_option("--input-cameras", setup.input_cameras, "input cameras")->check(CLI::Range(1, 256));
  verb.add_option("--input-size", setup.input_size, "their width and height, pixels")->check(CLI::Range(16, 1024));
  verb.add_option("--budget", setup.budget, "samples that become Gaussians")->check(CLI::Range(1, 10000000));
  verb.add_option("--ready-gaussians", setup.ready_gaussians,
                  "Gaussians that make the model count as there; 0: 95 % of the budget");
  verb.add_option("--seed", setup.seed, "of the trainer's random choices; the scene is the launch file's");
  verb.add_option("--timeout", setup.timeout_s, "longest wait for any one thing, s")->check(CLI::PositiveNumber);
  verb.add_option("--out", options.out, "folder for what is written");
  verb.add_option("--launch", options.launch_file, "launch file (default: launch/eval_fixed.yaml of this build)");
  verb.add_flag("--json", options.json, "progress and summary as JSON, one object a line");
  add_backend_option(verb, setup.backend);
}

}  // namespace

void add_eval_verb(CLI::App& app, Action& action) {
  CLI::App* eval = app.add_subcommand("eval", "Measure the quality that the real services reach");
  eval->require_subcommand(1);
  auto options = std::make_shared<EvalOptions>();
  CLI::App* verb = eval->add_subcommand(
      "fixed", "Fixed cameras in a circle, held-out views between them; SSIM, PSNR and FLIP over the iterations");
  add_setup_options(*verb, *options);
  FixedEvaluationOptions& fixed = options->fixed;
  verb->add_option("--iterations", fixed.iterations, "optimizer steps")->check(CLI::Range(1, 1000000));
  verb->add_option("--every", fixed.every, "steps between evaluations")->check(CLI::Range(1, 1000000));
  verb->add_option("--views", fixed.views, "held-out views")->check(CLI::Range(1, 64));
  verb->callback([options, &action] { action = [options] { return evaluate_fixed(*options); }; });

  auto start_options = std::make_shared<EvalOptions>();
  CLI::App* start = eval->add_subcommand("start", "How soon after the engine's first frame there is a trained model");
  add_setup_options(*start, *start_options);
  start->callback([start_options, &action] { action = [start_options] { return evaluate_start(*start_options); }; });
}

}  // namespace splatbus::cli
