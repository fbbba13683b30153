#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <map>

#include "dynamics_evaluation.h"
#include "eval_options.h"
#include "explore_evaluation.h"
#include "fixed_evaluation.h"
#include "moving_evaluation.h"
#include "relight_evaluation.h"
#include "replay_evaluation.h"
#include "start_evaluation.h"

namespace splatbus::cli {

namespace {

struct FixedVerbOptions : CommonOptions {
  FixedEvaluationOptions fixed;
};

struct StartVerbOptions : CommonOptions {
  EvaluationSetup setup;
};

struct DynamicsVerbOptions : CommonOptions {
  DynamicsOptions dynamics;
};

struct MovingVerbOptions : CommonOptions {
  MovingOptions moving;
};

struct ExploreVerbOptions : CommonOptions {
  ExploreOptions explore;
};

struct RelightVerbOptions : CommonOptions {
  RelightEvaluationOptions relight;
};

int evaluate_fixed(FixedVerbOptions options) {
  options.complete(options.fixed.setup);
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

int evaluate_start(StartVerbOptions options) {
  options.complete(options.setup);
  return evaluate(options, "summary.json", [&](const StopSignals& signals, const auto& show) {
    return run_start_evaluation(options.setup, signals, show);
  });
}

int evaluate_dynamics(DynamicsVerbOptions options) {
  options.complete(options.dynamics.setup);
  return evaluate(options, "figures.csv, summary.json, turning_0.png ...",
                  [&](const StopSignals& signals, const auto& show) {
                    return run_dynamics_evaluation(options.dynamics, signals, show);
                  });
}

int evaluate_moving(MovingVerbOptions options) {
  options.complete(options.moving.setup);
  return evaluate(options, "figures.csv, figures.png, summary.json", [&](const StopSignals& signals, const auto& show) {
    return run_moving_evaluation(options.moving, signals, show);
  });
}

int evaluate_explore(ExploreVerbOptions options) {
  options.complete(options.explore.run.setup);
  return evaluate(options, "figures.csv, figures.png, contact_sheet.png, worst.png, summary.json",
                  [&](const StopSignals& signals, const auto& show) {
                    return run_explore_evaluation(options.explore, signals, show);
                  });
}

int evaluate_relight(RelightVerbOptions options) {
  options.complete(options.relight.setup);
  return evaluate(options, "summary.json, contact_sheet.png", [&](const StopSignals& signals, const auto& show) {
    return run_relight_evaluation(options.relight, signals, show);
  });
}

void add_fixed_verb(CLI::App& eval, Action& action) {
  auto options = std::make_shared<FixedVerbOptions>();
  CLI::App* verb = eval.add_subcommand(
      "fixed", "Fixed cameras in a circle, held-out views between them; SSIM, PSNR and FLIP over the iterations");
  FixedEvaluationOptions& fixed = options->fixed;
  add_setup_options(*verb, *options, fixed.setup);
  verb->add_option("--iterations", fixed.iterations, "optimizer steps")->check(CLI::Range(1, 1000000));
  verb->add_option("--every", fixed.every, "steps between evaluations")->check(CLI::Range(1, 1000000));
  verb->add_option("--views", fixed.views, "held-out views")->check(CLI::Range(1, 64));
  verb->callback([options, &action] { action = [options] { return evaluate_fixed(*options); }; });
}

void add_start_verb(CLI::App& eval, Action& action) {
  auto options = std::make_shared<StartVerbOptions>();
  CLI::App* verb = eval.add_subcommand("start", "Time from the engine's first frame to a trained model");
  add_setup_options(*verb, *options, options->setup);
  verb->callback([options, &action] { action = [options] { return evaluate_start(*options); }; });
}

void add_dynamics_verb(CLI::App& eval, Action& action) {
  auto options = std::make_shared<DynamicsVerbOptions>();
  options->default_launch = "eval_dynamics.yaml";
  CLI::App* verb = eval.add_subcommand(
      "dynamics", "A moving sun and objects: quality of held-out views over time, compared with the still scene");
  DynamicsOptions& dynamics = options->dynamics;
  add_setup_options(*verb, *options, dynamics.setup);
  verb->add_option("--seconds", dynamics.seconds, "duration of the living scene, s")->check(CLI::Range(5.0, 86400.0));
  verb->add_option("--still-seconds", dynamics.still_seconds, "duration of the still scene before it, s; 0: none")
      ->check(CLI::Range(0.0, 86400.0));
  verb->add_flag("--still", dynamics.still_only, "run only the still scene, for --seconds");
  verb->add_option("--lights", dynamics.lights,
                   "lights of the living scene, one run each: turning (sun), fixed (sun), points (three at night)")
      ->delimiter(',')
      ->transform(CLI::CheckedTransformer(std::map<std::string, SceneLight>{
          {"turning", SceneLight::TurningSun}, {"fixed", SceneLight::FixedSun}, {"points", SceneLight::PointLights}}));
  verb->add_option("--sun-rate", dynamics.sun_rate_deg_s, "rate of the turning sun, degrees per second");
  verb->add_option("--support", dynamics.support,
                   "scene state that is drawn: on (that of each picture), off (that of the start), or both")
      ->transform(CLI::CheckedTransformer(
          std::map<std::string, Support>{{"on", Support::On}, {"off", Support::Off}, {"both", Support::Both}}));
  verb->add_option("--fps", dynamics.fps, "engine frames per second")->check(CLI::Range(1.0, 240.0));
  verb->add_option("--reference-rate", dynamics.reference_rate_hz, "pictures per second of each reference camera")
      ->check(CLI::Range(0.1, 240.0));
  verb->callback([options, &action] { action = [options] { return evaluate_dynamics(*options); }; });
}

void add_moving_verb(CLI::App& eval, Action& action) {
  auto options = std::make_shared<MovingVerbOptions>();
  options->default_launch = "eval_moving.yaml";
  CLI::App* verb = eval.add_subcommand(
      "moving", "An orbiting viewer: reference cameras that stand on its circle, compared with a rig that follows it");
  MovingOptions& moving = options->moving;
  add_setup_options(*verb, *options, moving.setup);
  verb->add_option("--rig-cameras", moving.rig_cameras, "reference cameras of the rig that follows")
      ->check(CLI::Range(1, 64));
  verb->add_option("--seconds", moving.seconds, "duration of each of the two runs, s")->check(CLI::Range(5.0, 86400.0));
  verb->add_option("--period", moving.period_s, "time of one orbit, s")->check(CLI::Range(0.1, 86400.0));
  verb->callback([options, &action] { action = [options] { return evaluate_moving(*options); }; });
}

void add_explore_verb(CLI::App& eval, Action& action) {
  auto options = std::make_shared<ExploreVerbOptions>();
  options->default_launch = "eval_explore.yaml";
  CLI::App* verb = eval.add_subcommand(
      "explore", "A walk through a world and back, then a teleport to the start: quality over time");
  ExploreRunOptions& run = options->explore.run;
  add_setup_options(*verb, *options, run.setup);
  verb->add_option("--seconds", run.seconds, "duration of the walk out, s")->check(CLI::Range(5.0, 86400.0));
  verb->add_option("--back-seconds", run.back_s, "duration of the way back, s (default: half of --seconds)")
      ->check(CLI::Range(1.0, 86400.0));
  verb->add_option("--speed", run.speed_m_s, "speed of the walk, m/s")->check(CLI::Range(0.01, 100.0));
  verb->add_option("--stay", run.stay_s, "time after the teleport, s")->check(CLI::Range(0.0, 86400.0));
  verb->add_option("--scene", run.scene, "scene of the engine");
  verb->get_option("--seed")->description("random seed of the scene and the trainer");
  verb->add_option("--path", run.path, "file with the walk, 'x y z' in m per line (default: the engine's own walk)")
      ->check(CLI::ExistingFile);
  verb->add_option("--world", run.world, "folder that keeps the world; it may hold one already");
  verb->add_option("--viewers", run.viewers, "number of viewers; the second walks 100 m ahead of the first")
      ->check(CLI::Range(1, 2));
  verb->add_option("--max-gaussians", run.max_gaussians, "most Gaussians in the model");
  verb->add_option("--start", run.start_m, "distance along the walk at which the first viewer begins, m")
      ->check(CLI::Range(0.0, 1e6));
  verb->add_option("--memory-mb", run.memory_mb, "ceiling of the trainer's memory, with --world, MiB; 0: none");
  verb->add_option("--disk-mb", run.disk_mb, "ceiling of the world folder, MiB; 0: none");
  verb->add_flag("--compare", options->explore.compare, "compare with the same run without freezing and culling");
  verb->add_flag("--halve", options->explore.halve,
                 "compare with the same run under half of the memory and disk that the first took");
  verb->add_flag("--alone", options->explore.alone, "compare with runs in which each of two viewers is alone");
  verb->callback([options, &action] { action = [options] { return evaluate_explore(*options); }; });
}

void add_relight_verb(CLI::App& eval, Action& action) {
  auto options = std::make_shared<RelightVerbOptions>();
  CLI::App* verb = eval.add_subcommand(
      "relight", "Train under one sun, then show suns 60 to 180 degrees away and point lights at night");
  RelightEvaluationOptions& relight = options->relight;
  add_setup_options(*verb, *options, relight.setup);
  verb->add_option("--iterations", relight.iterations, "optimizer steps under the first sun")
      ->check(CLI::Range(1, 1000000));
  verb->add_option("--views", relight.views, "held-out views")->check(CLI::Range(1, 64));
  verb->callback([options, &action] { action = [options] { return evaluate_relight(*options); }; });
}

}  // namespace

void add_setup_options(CLI::App& verb, CommonOptions& options, EvaluationSetup& setup) {
  verb.option_defaults()->always_capture_default();
  verb.add_option("--cameras", setup.cameras, "number of reference cameras")->check(CLI::Range(1, 64));
  verb.add_option("--size", setup.size, "width and height of reference pictures, pixels")->check(CLI::Range(32, 2048));
  verb.add_option("--input-cameras", setup.input_cameras, "number of input cameras")->check(CLI::Range(1, 256));
  verb.add_option("--input-size", setup.input_size, "width and height of input pictures, pixels")
      ->check(CLI::Range(16, 1024));
  verb.add_option("--budget", setup.budget, "most samples that become Gaussians")->check(CLI::Range(1, 10000000));
  verb.add_option("--ready-gaussians", setup.ready_gaussians,
                  "Gaussians at which the model counts as complete; 0: 95 % of the budget");
  verb.add_option("--seed", setup.seed, "random seed of the trainer; the launch file sets the scene");
  verb.add_option("--timeout", setup.timeout_s, "longest wait for any one step, s")->check(CLI::PositiveNumber);
  verb.add_option("--out", options.out, "output folder");
  verb.add_option("--launch", options.launch_file,
                  fmt::format("launch file (default: launch/{} of this build)", options.default_launch));
  verb.add_flag("--json", options.json, "print progress and summary as JSON, one object per line");
  add_backend_option(verb, setup.backend);
}

void add_eval_verb(CLI::App& app, Action& action) {
  CLI::App* eval = app.add_subcommand("eval", "Measure the quality that the real services reach");
  eval->require_subcommand(1);
  add_fixed_verb(*eval, action);
  add_start_verb(*eval, action);
  add_dynamics_verb(*eval, action);
  add_moving_verb(*eval, action);
  add_explore_verb(*eval, action);
  add_relight_verb(*eval, action);
  add_stream_verbs(*eval, action);
  add_replay_verb(*eval, action);
}

}  // namespace splatbus::cli
