#include <fmt/format.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <condition_variable>
#include <mutex>

#include "gateway_url.h"
#include "launch_file.h"
#include "launch_plan.h"
#include "schema_json.h"
#include "supervised_run.h"
#include "supervisor.h"
#include "terminal.h"
#include "verbs.h"

namespace splatbus::cli {

namespace {

struct LaunchOptions {
  std::string file;
  std::vector<std::string> overrides;
  std::string bus, backend, world;
  double seconds = 0;
  bool check = false;
  bool json = false;
};

std::string json_line(const OutputLine& line) {
  if (line.event.empty()) return json_text({{"service", line.process}, {"line", line.text}});
  nlohmann::json json{{"service", line.process}, {"event", line.event}, {"text", line.text}};
  if (line.pid != 0) json["pid"] = line.pid;
  if (line.exit && line.exit->signal != 0) json["signal"] = line.exit->signal;
  if (line.exit && line.exit->signal == 0) json["status"] = line.exit->code;
  if (line.restart_in_s) json["restart_in_s"] = *line.restart_in_s;
  return json_text(json);
}

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

  if (gateway) {
    fmt::print("{}\n", options.json ? json_text({{"url", gateway->url}}) : invitation(*gateway));
    std::fflush(stdout);
  }
  const StopSignals signals;
  std::vector<std::string> names;
  for (const ProcessPlan& process : plan.processes) names.push_back(process.name);
  const PrefixedOutput output(names, !options.json && is_terminal(STDOUT_FILENO));
  Supervisor supervisor(plan, [&](const OutputLine& line) {
    if (options.json) {
      fmt::print("{}\n", json_line(line));
      std::fflush(stdout);
    } else {
      output.print(line.process, line.text, !line.event.empty());
    }
  });

  std::stop_source stop;
  const std::stop_callback on_signal(signals.stop(), [&] { stop.request_stop(); });
  std::jthread timer;
  if (options.seconds > 0) {
    timer = std::jthread([&](const std::stop_token& end) {
      std::mutex mutex;
      std::unique_lock lock(mutex);
      std::condition_variable_any().wait_for(lock, end, std::chrono::duration<double>(options.seconds),
                                             [] { return false; });
      stop.request_stop();
    });
  }
  const bool success = supervisor.run(stop.get_token(), signals.kill());
  if (!success) fmt::print(stderr, "splatbus launch: {}\n", *supervisor.failure());
  return success ? 0 : 1;
}

}  // namespace

void add_launch_verb(CLI::App& app, Action& action) {
  auto options = std::make_shared<LaunchOptions>();
  CLI::App* verb = app.add_subcommand("launch", "Start and look after the services of a launch file");
  verb->add_option("file", options->file, "launch file (YAML)")->required();
  verb->add_option("--set", options->overrides, "service.key=value: set a parameter of a service (repeatable)")
      ->allow_extra_args(false);
  verb->add_option("--world", options->world, "folder that keeps the model across runs (made where there is none)");
  verb->add_option("--seconds", options->seconds, "stop after that long; 0: run until Ctrl-C")
      ->check(CLI::NonNegativeNumber);
  verb->add_flag("--check", options->check, "check the file, print the processes in starting order, and start nothing");
  verb->add_flag("--json", options->json, "one JSON object a line of output");
  add_backend_option(*verb, options->backend);
  add_bus_option(*verb, options->bus);
  verb->callback([options, &action] { action = [options] { return launch(*options); }; });
}

}  // namespace splatbus::cli
