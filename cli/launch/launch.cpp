#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <utility>

#include "gateway_url.h"
#include "launch_file.h"
#include "launch_plan.h"
#include "run_launch.h"
#include "schema_json.h"
#include "verbs.h"

namespace splatbus::cli {

namespace {

struct LaunchOptions {
  std::string file;
  std::vector<std::string> overrides;
  std::string bus, backend, world;
  double seconds = 0;
  bool check = false;
  bool detach = false;
  double ready_within_s = 120;
  bool json = false;
};

void print_plan(const LaunchPlan& plan, bool json) {
  for (const ProcessPlan& process : plan.processes) {
    std::vector<std::string> after;
    for (const std::size_t index : process.after) after.push_back(plan.processes[index].name);
    fmt::print(
        "{}\n",
        json ? json_text({{"service", process.name},
                          {"program", process.program.string()},
                          {"arguments", process.arguments},
                          {"backend", process.backend.empty() ? nlohmann::json() : nlohmann::json(process.backend)},
                          {"after", after}})
             : process.name);
  }
}

int launch(const LaunchOptions& options) {
  LaunchFile file = read_launch_file(options.file);
  for (const std::string& assignment : options.overrides) apply_override(file, assignment);
  set_backend(file, options.backend);
  set_world(file, options.world);
  bus::Address address = bus_address(options.bus);
  if (options.bus.empty() && file.bus) {
    try {
      address = bus::Address::parse(file.bus->value);
    } catch (const bus::Error& error) {
      throw LaunchError(file.bus->mark, error.what());
    }
  }
  const auto gateway = settle_gateway(file);
  const LaunchPlan plan = plan_launch(file, address, program_directory());
  check_backends(file);
  check_parameters(file, plan);
  if (options.check) {
    print_plan(plan, options.json);
    return 0;
  }

  RunLaunch run{.file = file,
                .plan = plan,
                .invitation = {},
                .json = options.json,
                .seconds = options.seconds,
                .detach = options.detach,
                .ready_within_s = options.ready_within_s};
  if (gateway) run.invitation = options.json ? json_text({{"url", gateway->url}}) : invitation(*gateway);
  return run_launch(run);
}

}  // namespace

void add_launch_verb(CLI::App& app, Action& action) {
  const auto add = [&](const char* name, const char* help) {
    auto options = std::make_shared<LaunchOptions>();
    CLI::App* verb = app.add_subcommand(name, help);
    verb->add_option("file", options->file, "launch file (YAML)")->required();
    verb->add_option("--set", options->overrides, "service.key=value: set a parameter of a service (repeatable)")
        ->allow_extra_args(false);
    verb->add_option("--world", options->world, "folder that keeps the model across runs (made where there is none)");
    verb->add_flag("--json", options->json, "one JSON object a line of output");
    add_backend_option(*verb, options->backend);
    add_bus_option(*verb, options->bus);
    verb->callback([options, &action] { action = [options] { return launch(*options); }; });
    return std::pair(verb, options);
  };
  const auto [verb, options] = add("launch", "Start and look after the services of a launch file");
  verb->add_option("--seconds", options->seconds, "stop after that long; 0: run until Ctrl-C")
      ->check(CLI::NonNegativeNumber);
  verb->add_flag("--check", options->check, "check the file, print the processes in starting order, and start nothing");
  const auto [up, up_options] = add("up", "Start the services of a launch file, in the background with -d");
  up->add_flag("-d,--detach", up_options->detach, "in the background; returns when everything is ready");
  up->add_option("--timeout", up_options->ready_within_s, "with -d: seconds until everything must be ready")
      ->check(CLI::Range(0.0, 86400.0));
}

}  // namespace splatbus::cli
