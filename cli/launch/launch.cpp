#include <fmt/format.h>
#include <fmt/ranges.h>

#include <CLI/CLI.hpp>
#include <optional>
#include <utility>

#include "bus/error.h"
#include "gateway_url.h"
#include "launch_file.h"
#include "launch_plan.h"
#include "parameter_check.h"
#include "run_launch.h"
#include "schema_json.h"
#include "shell_words.h"
#include "verbs.h"

namespace splatbus::cli {

namespace {

struct LaunchOptions {
  std::string file;
  std::vector<std::string> arguments, overrides;
  std::string bus, backend, world;
  double seconds = 0;
  bool validate = false, dry_run = false, schema = false;
  bool json = false, detach = false;
  double ready_within_s = 120;
};

void print_plan(const LaunchPlan& plan, bool json) {
  for (std::size_t i = 0; i < plan.processes.size(); ++i) {
    const ProcessPlan& process = plan.processes[i];
    std::vector<std::string> after;
    for (const std::size_t index : process.after) after.push_back(plan.processes[index].name);
    if (json) {
      fmt::print("{}\n",
                 json_text({{"service", process.name},
                            {"program", process.program.string()},
                            {"arguments", process.arguments},
                            {"environment", process.environment},
                            {"backend", process.backend.empty() ? nlohmann::json() : nlohmann::json(process.backend)},
                            {"after", after}}));
      continue;
    }
    std::string environment;
    for (const auto& [key, value] : process.environment) environment += fmt::format("{}={} ", key, shell_line({value}));
    std::vector<std::string> command{process.program.string()};
    command.insert(command.end(), process.arguments.begin(), process.arguments.end());
    fmt::print("{}. {}{}\n   {}{}\n", i + 1, process.name,
               after.empty() ? "" : fmt::format(", after {}", fmt::join(after, ", ")), environment,
               shell_line(command));
  }
}

/// A launch file with what the command line says of it, checked.
struct CheckedLaunch {
  LaunchFile file;
  LaunchPlan plan;
  std::optional<GatewayUrl> gateway;
};

CheckedLaunch check(const LaunchOptions& options) {
  LaunchFile file = read_launch_file(options.file, parse_arguments(options.arguments));
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
  CheckedLaunch checked;
  checked.gateway = settle_gateway(file);
  checked.plan = plan_launch(file, address, program_directory());
  check_backends(file);
  check_parameters(file, checked.plan);
  checked.file = std::move(file);
  return checked;
}

nlohmann::json problem_json(const LaunchProblem& problem) {
  return {{"file", problem.mark.file},
          {"line", problem.mark.line},
          {"column", problem.mark.column},
          {"severity", "error"},
          {"message", problem.text}};
}

int validate(const LaunchOptions& options) {
  std::vector<LaunchProblem> problems;
  std::size_t processes = 0;
  try {
    processes = check(options).plan.processes.size();
  } catch (const LaunchError& error) {
    problems = error.problems();
    if (!options.json) fmt::print(stderr, "{}\n", error.what());
  }
  if (options.json) {
    nlohmann::json list = nlohmann::json::array();
    for (const LaunchProblem& problem : problems) list.push_back(problem_json(problem));
    fmt::print("{}\n", json_text({{"file", options.file}, {"valid", problems.empty()}, {"problems", list}}));
  } else if (problems.empty()) {
    fmt::print("{}: valid, {} processes\n", options.file, processes);
  }
  return problems.empty() ? 0 : 1;
}

int launch(const LaunchOptions& options) {
  if (options.schema) {
    fmt::print("{}", launch_schema());
    return 0;
  }
  if (options.validate) return validate(options);
  const auto [file, plan, gateway] = check(options);
  if (options.dry_run) {
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
    verb->add_option("file", options->file, "launch file (YAML)");
    verb->add_option("arguments", options->arguments, "name=value: an argument of the launch file");
    verb->add_option("--set", options->overrides, "service.key=value: set a parameter of a service (repeatable)")
        ->allow_extra_args(false);
    verb->add_option("--world", options->world, "folder that keeps the model across runs (created if missing)");
    verb->add_flag("--json", options->json, "print JSON, one object per line");
    add_backend_option(*verb, options->backend);
    add_bus_option(*verb, options->bus);
    verb->callback([options, &action] {
      if (options->file.empty() && !options->schema) throw CLI::RequiredError("file");
      action = [options] { return launch(*options); };
    });
    return std::pair(verb, options);
  };
  const auto [verb, options] = add("launch", "Start the services of a launch file and keep them running");
  verb->add_option("--seconds", options->seconds, "stop after this many seconds; 0: run until Ctrl-C")
      ->check(CLI::NonNegativeNumber);
  verb->add_flag("--validate,--check", options->validate, "check the file and start nothing");
  verb->add_flag("--dry-run", options->dry_run, "print every process in starting order and start nothing");
  verb->add_flag("--schema", options->schema, "print the JSON schema of launch files");
  const auto [up, up_options] = add("up", "Start the services of a launch file, in the background with -d");
  CLI::Option* const detach =
      up->add_flag("-d,--detach", up_options->detach, "run in the background; return when everything is ready");
  up->add_option("--timeout", up_options->ready_within_s, "with -d: seconds until everything must be ready")
      ->needs(detach)
      ->check(CLI::Range(0.0, 86400.0));
}

}  // namespace splatbus::cli
