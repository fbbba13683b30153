#include "explore_plan.h"

#include <fmt/format.h>
#include <poll.h>

#include <algorithm>
#include <stdexcept>
#include <utility>

#include "child_process.h"
#include "figures.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;

constexpr double kApart_m = 100;  // of two viewers

void change_launch(const ExploreRunOptions& options, const fs::path& pictures, LaunchFile& file) {
  const EvaluationSetup& setup = options.setup;
  LaunchService* engine = file.find("engine");
  LaunchService* viewer = file.find("viewer");
  if (engine == nullptr || viewer == nullptr) {
    throw LaunchError({file.path, 0, 0}, "there is no service 'engine' or 'viewer'");
  }
  if (!options.scene.empty()) set_flag(engine->args, "--scene", options.scene);
  set_flag(engine->args, "--seed", std::to_string(setup.seed));
  viewer->replicas = options.viewers;
  const std::string size = std::to_string(setup.size);
  Settings settings{
      {"capture-bridge.reference_rig", "follow"},
      {"viewer.width", size},
      {"viewer.height", size},
      {"viewer.path", "walk"},
      {"viewer.path_file", (fs::absolute(setup.out) / "path_${name}.txt").string()},
      {"viewer.path_run", "false"},
      {"viewer.speed_m_s", fmt::format("{}", options.speed_m_s)},
      {"viewer.out", (pictures / "${name}").string()},
  };
  if (options.max_gaussians) {
    for (const char* service : {"trainer", "expander"}) {
      settings.emplace_back(fmt::format("{}.max_gaussians", service), std::to_string(*options.max_gaussians));
    }
  }
  if (!options.world.empty()) settings.emplace_back("trainer.world", fs::absolute(options.world).string());
  for (const char* ceiling : {"device_mb", "host_mb"}) {
    if (options.memory_mb > 0)
      settings.emplace_back(fmt::format("trainer.{}", ceiling), std::to_string(options.memory_mb));
  }
  if (options.disk_mb > 0) settings.emplace_back("trainer.disk_mb", std::to_string(options.disk_mb));
  if (!options.rests) {
    settings.emplace_back("trainer.freeze", "false");
    settings.emplace_back("trainer.cull", "false");
  }
  apply_settings(settings, file);
}

}  // namespace

std::string print_walk(const ProcessPlan& engine) {
  std::vector<std::string> arguments = engine.arguments;
  arguments.emplace_back("--print-walk");
  ChildProcess child(engine.program, arguments, engine.environment);
  std::vector<std::string> lines;
  std::optional<ExitStatus> exit;
  while (!(exit = child.poll_exit())) {
    pollfd ready[] = {{child.exit_fd(), POLLIN, 0}, {child.output_fd(), POLLIN, 0}};
    ::poll(ready, 2, -1);
    for (std::string& line : child.read_lines(false)) lines.push_back(std::move(line));
  }
  for (std::string& line : child.read_lines(true)) lines.push_back(std::move(line));
  std::string text;
  for (const std::string& line : lines) text += line + "\n";
  if (!exit->success()) {
    throw std::runtime_error(fmt::format("the engine has no walk through this scene: give one with --path ({} {})\n{}",
                                         engine.program.string(), exit->text(), text));
  }
  return text;
}

ExplorePlan plan_exploration(const ExploreRunOptions& options, const bus::Address& address, const fs::path& pictures) {
  ExplorePlan plan;
  plan.launch =
      plan_evaluation(options.setup, address, false, [&](LaunchFile& file) { change_launch(options, pictures, file); });
  fs::path path = options.path;
  if (path.empty()) {
    const auto engine = std::ranges::find(plan.launch.processes, "engine", &ProcessPlan::name);
    path = options.setup.out / "walk.txt";
    write_text(path, print_walk(*engine));
  }
  const std::vector<viewer::PathLeg> legs = viewer::read_path_points(path);
  if (legs.size() != 1) throw std::runtime_error(path.string() + ": a walk has no teleports");
  plan.apart_m = std::min(kApart_m, length_m(legs.front()) / 2);
  for (int i = 0; i < options.viewers; ++i) {
    plan.viewers.push_back(options.viewers == 1 ? "viewer" : fmt::format("viewer-{}", i + 1));
    const double from_m = options.start_m + i * plan.apart_m;
    plan.ways.emplace_back(legs.front(), from_m, options.seconds, options.back_s.value_or(options.seconds / 2),
                           options.speed_m_s);
    write_text(options.setup.out / fmt::format("path_{}.txt", plan.viewers.back()), plan.ways.back().path_text());
  }
  return plan;
}

}  // namespace splatbus::cli
