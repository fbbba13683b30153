#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "demo_run.h"
#include "launch_plan.h"
#include "schema_json.h"
#include "terminal.h"
#include "verbs.h"

namespace splatbus::cli {

namespace {

/// The script of a source tree says what it was called by.
std::string command_as_typed() {
  const char* const typed = std::getenv("SPLATBUS_TYPED_AS");
  return typed ? typed : "splatbus";
}

struct DemoVerbOptions {
  DemoOptions demo;
  std::string out = "out/demo";
  std::string launch_file;
  bool json = false;
};

std::string ssim_text(const std::optional<double>& ssim) {
  return ssim ? fmt::format("{:.3f}", *ssim) : "-";
}

/// A terminal of 80 columns cuts the last figure off.
std::string live_line(const DemoState& state) {
  return fmt::format(
      "{:3.0f} s  {}/{} up  {} Gaussians  SSIM {}, viewer {}  {:.0f} steps/s  {:.1f} Mbit/s  {:.1f} pictures/s",
      state.elapsed_s, state.running, state.services, state.gaussians, ssim_text(state.ssim_server),
      ssim_text(state.ssim_viewer), state.steps_per_s, state.wire_mbps, state.pictures_per_s);
}

nlohmann::json to_json(const DemoState& state) {
  const auto figure = [](const std::optional<double>& value) {
    return value ? nlohmann::json(rounded(*value)) : nlohmann::json();
  };
  return {{"elapsed_s", rounded(state.elapsed_s)},
          {"running", state.running},
          {"services", state.services},
          {"pictures_per_s", rounded(state.pictures_per_s)},
          {"gaussians", state.gaussians},
          {"steps_per_s", rounded(state.steps_per_s)},
          {"ssim_server", figure(state.ssim_server)},
          {"ssim_viewer", figure(state.ssim_viewer)},
          {"wire_mbps", rounded(state.wire_mbps)}};
}

int demo(DemoVerbOptions options) {
  options.demo.out = options.out;
  options.demo.launch_file =
      options.launch_file.empty() ? default_launch_file("demo.yaml") : std::filesystem::path(options.launch_file);
  const StopSignals signals;
  ProgressLine line;
  const auto started = [&](const DemoStart& start) {
    if (options.json) {
      if (start.gateway) fmt::print("{}\n", json_text({{"url", start.gateway->url}}));
      return;
    }
    fmt::print("{:.0f} s demo on the bus {}\n", options.demo.seconds, start.bus);
    // Its first use would build it, on the cores that the demo needs.
    if (std::filesystem::exists(program_directory() / "splatbus"))
      fmt::print("look inside with: {} node list --bus {}\n", command_as_typed(), start.bus);
    if (start.gateway) fmt::print("{}\n", invitation(*start.gateway));
    std::fflush(stdout);
  };
  const auto show = [&](const DemoState& state) {
    if (options.json) {
      fmt::print("{}\n", json_text(to_json(state)));
      std::fflush(stdout);
    } else {
      line.show(live_line(state));
    }
  };
  const nlohmann::json summary = run_demo(options.demo, signals, started, show);
  line.finish();
  fmt::print("{}\n", json_text(summary, options.json ? -1 : 2));
  if (!options.json) fmt::print("{}: contact_sheet.png, model.ply, summary.json\n", options.out);
  if (summary.contains("note")) fmt::print(stderr, "splatbus demo: {}\n", summary["note"].get<std::string>());
  return summary["ssim_viewer"].is_null() ? 1 : 0;
}

}  // namespace

void add_demo_verb(CLI::App& app, Action& action) {
  auto options = std::make_shared<DemoVerbOptions>();
  CLI::App* verb = app.add_subcommand("demo", "Run the whole pipeline on a built-in scene, with measured quality");
  verb->option_defaults()->always_capture_default();
  verb->add_option("--seconds", options->demo.seconds, "duration, s")->check(CLI::Range(5.0, 86400.0));
  verb->add_flag("--still", options->demo.still, "keep sun and objects still");
  verb->add_option("--seed", options->demo.seed, "random seed of the scene and the trainer")
      ->check(CLI::Range(std::uint64_t{0}, std::uint64_t{0xFFFFFFFF}));
  verb->add_option("--out", options->out, "output folder for contact_sheet.png, model.ply and summary.json");
  verb->add_option("--launch", options->launch_file, "launch file (default: launch/demo.yaml of this build)");
  verb->add_option("--bus", options->demo.bus, "bus address (default: a temporary folder)");
  add_backend_option(*verb, options->demo.backend);
  verb->add_flag("--json", options->json, "print live figures and summary as JSON, one object per line");
  verb->callback([options, &action] { action = [options] { return demo(*options); }; });
}

}  // namespace splatbus::cli
