// The verbs of an operator: what they ask the supervisor, and how its answers are shown.
#include <fmt/format.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <filesystem>
#include <iterator>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>

#include "bus/nearest.h"
#include "control_request.h"
#include "control_socket.h"
#include "log_store.h"
#include "terminal.h"
#include "verbs.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::json;

constexpr double kWaitS = 60;

struct OperateOptions {
  std::string bus, scale, since, service, backend, program;
  std::vector<std::string> services, settings;
  std::optional<double> wait_s;
  int tail = -1;
  bool json = false, follow = false;
};

std::string duration(double seconds) {
  const auto whole = static_cast<long>(seconds);
  if (whole < 60) return fmt::format("{} s", whole);
  if (whole < 3600) return fmt::format("{} min {} s", whole / 60, whole % 60);
  return fmt::format("{} h {} min", whole / 3600, whole / 60 % 60);
}

int status(const OperateOptions& options) {
  const Json answer = ask_supervisor(bus_address(options.bus), {{"verb", "status"}});
  if (options.json) {
    fmt::print("{}\n", answer.dump(-1, ' ', false, Json::error_handler_t::replace));
    return 0;
  }
  std::size_t width = 4;
  for (const Json& p : answer.at("services")) width = std::max(width, p.at("name").get<std::string>().size());
  fmt::print("{:<{}}  {:<9} {:>8} {:>13} {:>8}  {}\n", "NAME", width, "STATE", "PID", "UP", "RESTARTS", "DETAIL");
  for (const Json& p : answer.at("services")) {
    const std::string beside =
        p.contains("beside") ? fmt::format(" (+ {} {})", p["beside"].value("role", ""), p["beside"].value("state", ""))
                             : "";
    fmt::print("{:<{}}  {:<9} {:>8} {:>13} {:>8}  {}{}\n", p.value("name", ""), width, p.value("state", ""),
               p.contains("pid") ? std::to_string(p.value("pid", 0)) : "-",
               p.contains("uptime_s") ? duration(p.value("uptime_s", 0.0)) : "-", p.value("restarts", 0),
               p.value("detail", ""), beside);
  }
  return 0;
}

/// A verb for some processes, with what it says on the way.
int change(const OperateOptions& options, Json request) {
  request["wait_s"] = options.wait_s.value_or(kWaitS);
  const Json answer = ask_supervisor(bus_address(options.bus), std::move(request),
                                     [](const std::string& text) { fmt::print(stderr, "{}\n", text); });
  if (options.json) fmt::print("{}\n", answer.dump());
  return 0;
}

int scale(const OperateOptions& options) {
  const std::size_t equals = options.scale.find('=');
  const std::string number = equals == std::string::npos ? "" : options.scale.substr(equals + 1);
  if (number.empty() || number.size() > 4 || number.find_first_not_of("0123456789") != std::string::npos) {
    throw std::runtime_error(fmt::format("'{}': expected NAME=NUMBER, as in streamer=2", options.scale));
  }
  return change(options,
                {{"verb", "scale"}, {"service", options.scale.substr(0, equals)}, {"replicas", std::stoi(number)}});
}

int swap(const OperateOptions& options) {
  Json request{{"verb", "swap"}, {"service", options.service}};
  if (!options.backend.empty()) request["backend"] = options.backend;
  if (!options.program.empty()) request["program"] = std::filesystem::absolute(options.program).string();
  for (const std::string& setting : options.settings) {
    const std::size_t equals = setting.find('=');
    if (equals == std::string::npos || equals == 0) {
      throw std::runtime_error(fmt::format("--set '{}': expected name=value", setting));
    }
    request["set"][setting.substr(0, equals)] = setting.substr(equals + 1);
  }
  return change(options, std::move(request));
}

int down(const OperateOptions& options) {
  const Json answer = stop_supervisor(bus_address(options.bus), options.wait_s);
  if (options.json) fmt::print("{}\n", answer.dump());
  return 0;
}

int attach(const OperateOptions& options) {
  const bus::Address bus = bus_address(options.bus);
  LineSocket socket = connect_control(bus);
  socket.set_patience(kAnswerWithinS);
  socket.send({{"version", kControlVersion}, {"verb", "attach"}});
  const auto answer = socket.receive();
  if (!answer || !answer->value("ok", false)) throw std::runtime_error("the supervisor does not answer");
  socket.set_patience(0);  // processes need not print anything
  const PrefixedOutput output({}, !options.json && wants_color(STDOUT_FILENO));
  while (const auto line = socket.receive()) {
    if (options.json) {
      fmt::print("{}\n", line->dump());
      std::fflush(stdout);
    } else if (line->contains("missed")) {
      fmt::print(stderr, "{} lines were missed: this terminal is too slow\n", line->value("missed", 0));
    } else {
      output.print(line->value("service", ""), line->value("line", line->value("text", "")), line->contains("event"));
    }
  }
  return 0;
}

/// Which processes' log files are asked for: by name or service, with their successors, and with replicas that are no
/// more or not yet. The supervisor, where it runs, knows what is a replica; else a name tells.
class AskedForLogs {
 public:
  AskedForLogs(std::vector<std::string> services, const std::optional<Json>& running) : services_(std::move(services)) {
    for (const Json& p : running ? running->at("services") : Json::array()) {
      service_of_[p.at("name")] = p.at("service");
    }
  }

  [[nodiscard]] bool is_asked_for(const std::string& process) const {
    return services_.empty() ||
           std::ranges::any_of(services_, [&](const std::string& service) { return is_of(process, service); });
  }

  void require_each(const std::vector<std::string>& logged) const {
    for (const std::string& service : services_) {
      if (std::ranges::any_of(logged, [&](const std::string& process) { return is_of(process, service); })) continue;
      std::set<std::string> known(logged.begin(), logged.end());
      for (const auto& [process, of] : service_of_) known.insert(of);
      throw std::runtime_error(
          fmt::format("there are no logs of '{}'{}", service, bus::suggestion(service, {known.begin(), known.end()})));
    }
  }

 private:
  [[nodiscard]] bool is_of(const std::string& logged, const std::string& service) const {
    const std::string_view next = ".next";
    const std::string process = logged.ends_with(next) ? logged.substr(0, logged.size() - next.size()) : logged;
    if (logged == service || process == service) return true;
    if (const auto known = service_of_.find(process); known != service_of_.end()) return known->second == service;
    const std::string replica = service + "-";
    return process.size() > replica.size() && process.starts_with(replica) &&
           process.find_first_not_of("0123456789", replica.size()) == std::string::npos;
  }

  std::vector<std::string> services_;
  std::map<std::string, std::string> service_of_;
};

int logs(const OperateOptions& options) {
  const bus::Address bus = bus_address(options.bus);
  std::optional<Json> running;
  std::optional<LineSocket> supervisor;
  try {
    constexpr double kPatienceS = 2;
    running = ask_supervisor(bus, {{"verb", "status"}}, {}, kPatienceS);
    supervisor.emplace(connect_control(bus));
  } catch (const NoSupervisor&) {
    if (options.follow) throw;
  } catch (const SupervisorSilent&) {  // the files are there all the same
    if (options.follow) throw;
  }
  std::filesystem::path folder = log_folder(bus);
  // A demo's are elsewhere, and go with it.
  const std::string told = running ? running->at("supervisor").value("log_folder", "") : "";
  if (!told.empty()) folder = told;
  const auto logged = logged_processes(folder);
  if (logged.empty() && running) throw std::runtime_error(fmt::format("no log files are kept of {}", bus.text()));
  if (logged.empty()) throw NoSupervisor(bus);
  const AskedForLogs asked(options.services, running);
  asked.require_each(logged);
  std::vector<std::string> names;
  std::ranges::copy_if(logged, std::back_inserter(names), [&](const auto& name) { return asked.is_asked_for(name); });
  const PrefixedOutput output(names, !options.json && wants_color(STDOUT_FILENO));
  const auto print = [&](const StoredLine& line) {
    if (options.json) {
      const Json json{{"time", line.time}, {"service", line.process}, {line.event ? "text" : "line", line.text}};
      fmt::print("{}\n", json.dump(-1, ' ', false, Json::error_handler_t::replace));
    } else {
      fmt::print("{} {}\n", line.time, output.format(line.process, line.text, line.event));
    }
    std::fflush(stdout);
  };
  const std::string since = since_time(options.since);
  if (!options.follow) {
    for (const StoredLine& line : read_logs(folder, names, since, options.tail)) print(line);
    return 0;
  }
  LogFollower follower(folder, [&](const std::string& process) { return asked.is_asked_for(process); });
  for (const StoredLine& line : follower.before(since, options.tail)) print(line);
  follower.run(supervisor->fd(), print);
  return 0;
}

}  // namespace

void add_operate_verbs(CLI::App& app, Action& action) {
  const auto add = [&](const char* name, const char* help, int (*run)(const OperateOptions&)) {
    CLI::App* verb = app.add_subcommand(name, help);
    auto options = std::make_shared<OperateOptions>();
    add_bus_option(*verb, options->bus);
    verb->callback([options, run, &action] { action = [options, run] { return run(*options); }; });
    return std::pair(verb, options);
  };
  const auto add_wait = [](CLI::App* verb, const std::shared_ptr<OperateOptions>& options) {
    verb->add_option("--timeout", options->wait_s, "seconds to wait for it")->check(CLI::Range(0.0, 86400.0));
    verb->add_flag("--json", options->json, "print the answer as JSON");
  };
  const auto [down_verb, down_options] = add("down", "Stop every process, and the supervisor", down);
  add_wait(down_verb, down_options);
  const auto [status_verb, status_options] = add("status", "Show what runs", status);
  status_verb->add_flag("--json", status_options->json, "print JSON");
  const auto [attach_verb, attach_options] = add("attach", "Show what the processes print, from now on", attach);
  attach_verb->add_flag("--json", attach_options->json, "one JSON object a line");
  const auto [logs_verb, logs_options] = add("logs", "Show the log files of some services, or of all", logs);
  logs_verb->add_option("services", logs_options->services, "services or processes");
  logs_verb->add_flag("-f,--follow", logs_options->follow, "go on with what is written from now on");
  logs_verb->add_option("--since", logs_options->since, "from 90s, 10m, 2h or 1d ago, or from 2026-11-23T03:32:00Z");
  logs_verb->add_option("-n,--tail", logs_options->tail, "the last lines only")->check(CLI::NonNegativeNumber);
  logs_verb->add_flag("--json", logs_options->json, "one JSON object a line");
  const auto add_change = [&](const char* name, const char* help, int (*run)(const OperateOptions&)) {
    const auto [verb, options] = add(name, help, run);
    verb->add_option("services", options->services, "services (all their replicas) or processes")->required();
    add_wait(verb, options);
  };
  add_change("start", "Start services that were stopped or failed", [](const OperateOptions& o) {
    return change(o, {{"verb", "start"}, {"services", o.services}});
  });
  add_change("stop", "Stop services, while the rest runs", [](const OperateOptions& o) {
    return change(o, {{"verb", "stop"}, {"services", o.services}});
  });
  add_change("restart", "Restart services, one process after the other", [](const OperateOptions& o) {
    return change(o, {{"verb", "restart"}, {"services", o.services}});
  });
  const auto [scale_verb, scale_options] = add("scale", "Set how many replicas of a service run", scale);
  scale_verb->add_option("replicas", scale_options->scale, "NAME=NUMBER")->required();
  add_wait(scale_verb, scale_options);
  const auto [swap_verb, swap_options] =
      add("swap", "Hand a service over to a new process of it, while the picture goes on", swap);
  swap_verb->add_option("service", swap_options->service, "service or process")->required();
  add_backend_option(*swap_verb, swap_options->backend);
  swap_verb->add_option("--set", swap_options->settings, "name=value of a parameter; repeatable")
      ->allow_extra_args(false);
  swap_verb->add_option("--program", swap_options->program, "another program for it")->check(CLI::ExistingFile);
  add_wait(swap_verb, swap_options);
}

}  // namespace splatbus::cli
