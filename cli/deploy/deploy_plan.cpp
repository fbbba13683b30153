#include "deploy_plan.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <set>
#include <utility>

#include "bus/error.h"
#include "shell_words.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;

constexpr int kGatewayPort = 7680;         // where it listens when nothing is said
constexpr const char* kBusWithinS = "60";  // of containers that start together the bus may be the last

std::string host_name(const std::string& text) {
  std::string name;
  for (const unsigned char c : text) {
    name += std::isalnum(c) != 0 ? static_cast<char>(std::tolower(c)) : '-';
  }
  while (name.starts_with('-')) name.erase(0, 1);
  while (name.ends_with('-')) name.pop_back();
  return name.empty() ? "splatbus" : name;
}

/// Of "--set key=value"; the last one counts.
std::string parameter(const DeployProcess& process, const std::string& key) {
  std::string value;
  for (std::size_t i = 0; i + 1 < process.command.size(); ++i) {
    if (process.command[i] == "--set" && process.command[i + 1].starts_with(key + "=")) {
      value = process.command[i + 1].substr(key.size() + 1);
    }
  }
  return value;
}

void set_parameter(DeployProcess& process, const std::string& key, const std::string& value) {
  for (std::size_t i = 0; i + 1 < process.command.size();) {
    const bool is_it = process.command[i] == "--set" && process.command[i + 1].starts_with(key + "=");
    const auto at = process.command.begin() + static_cast<std::ptrdiff_t>(i);
    if (is_it) process.command.erase(at, at + 2);
    i += is_it ? 0 : 1;
  }
  process.command.insert(process.command.end(), {"--set", fmt::format("{}={}", key, value)});
}

std::string secret(DeployProcess& process, const std::string& file) {
  process.secrets.push_back(file);
  return fmt::format("{}/{}", kKeyFolder, file);
}

int port_of(const std::string& endpoint) {
  const std::size_t colon = endpoint.rfind(':');
  if (colon == std::string::npos) return 0;
  try {
    return std::stoi(endpoint.substr(colon + 1));
  } catch (const std::exception&) {
    return 0;
  }
}

/// It listens at another port than the launch file says, or on all addresses: its probes ask there.
void move_probes(DeployProcess& process, int from, int to) {
  if (from == 0) return;  // it listens nowhere: a URL without a port is somebody else's
  for (std::optional<Probe>* probe : {&process.readiness, &process.liveness}) {
    if (!*probe || (*probe)->kind == Probe::Kind::Command) continue;
    std::string& target = (*probe)->target;
    const std::size_t scheme = target.find("://");
    const std::size_t begin = scheme == std::string::npos ? 0 : scheme + 3;
    const std::size_t end = std::min(target.find('/', begin), target.size());
    if (port_of(target.substr(begin, end - begin)) != from) continue;
    target.replace(begin, end - begin, fmt::format("127.0.0.1:{}", to));
  }
}

void place_broker(DeployProcess& process) {
  for (std::size_t i = 0; i + 1 < process.command.size(); ++i) {
    if (process.command[i] != "--tcp") continue;
    const int port = port_of(process.command[i + 1]);
    process.command[i + 1] = fmt::format("0.0.0.0:{}", port);
    process.ports = {{"bus", port}, {"bus-read", port + 1}};
    for (const DeployPort& open : process.ports) move_probes(process, open.port, open.port);
    process.command.insert(process.command.end(),
                           {"--key", secret(process, "server_key"), "--allowed", secret(process, "allowed")});
    return;
  }
}

void place_gateway(DeployProcess& process, const DeployOptions& options) {
  process.ports = {{"http", options.gateway_port}};
  const std::string before = parameter(process, "http");
  move_probes(process, before.empty() ? kGatewayPort : port_of(before), options.gateway_port);
  set_parameter(process, "http", fmt::format("0.0.0.0:{}", options.gateway_port));
  set_parameter(process, "tokens", secret(process, "tokens"));
  if (parameter(process, "certificate").empty()) {
    set_parameter(process, "insecure", "true");  // what is before it speaks TLS
  } else {
    set_parameter(process, "certificate", secret(process, "certificate"));
    set_parameter(process, "key", secret(process, "certificate_key"));
  }
}

void place_streamer(DeployProcess& process, int port) {
  process.ports = {{"stream", port}};
  move_probes(process, port_of(parameter(process, "tcp")), port);
  set_parameter(process, "tcp", fmt::format("tcp://0.0.0.0:{}", port));
  set_parameter(process, "tcp_address", process.name);
  set_parameter(process, "key", secret(process, "server_key"));
  set_parameter(process, "allowed", secret(process, "allowed"));
}

/// A bus over tcp needs a key there.
void place_client(DeployProcess& process, const std::string& bus) {
  const auto option = std::ranges::find(process.command, "--bus");
  if (option != process.command.end()) *std::next(option) = bus;
  process.environment["SPLATBUS_BUS"] = bus;  // which probes read
  process.environment["SPLATBUS_KEY"] = secret(process, "client_key");
}

void check_remote(const LaunchFile& file, const std::map<std::string, std::string>& remote) {
  for (const auto& [name, bus] : remote) {
    const auto is_it = [&entry = name](const LaunchService& service) { return service.name == entry; };
    if (std::ranges::none_of(file.services, is_it)) {
      throw LaunchError({"--remote", 0, 0}, fmt::format("unknown service '{}' of {}", name, file.path));
    }
    if (bus::Address::parse(bus).is_local()) {
      throw LaunchError({"--remote", 0, 0}, fmt::format("'{}={}': expected tcp://host:port", name, bus));
    }
  }
}

DeployProcess containerised(const ProcessPlan& plan, const LaunchService& service, const fs::path& programs) {
  DeployProcess process;
  process.name = plan.name;
  process.service = service.name;
  const bool is_ours = plan.program.parent_path() == programs;
  process.command = {is_ours ? plan.program.filename().string() : plan.program.string()};
  process.command.insert(process.command.end(), plan.arguments.begin(), plan.arguments.end());
  const std::string verb = process.command.size() > 1 ? process.command[1] : "";
  if (is_ours && process.command[0] == "splatbus" && (verb == "record" || verb == "play")) {
    process.command.insert(process.command.begin() + 2, {"--wait", kBusWithinS});
  }
  process.environment = plan.environment;
  process.nice = plan.nice;
  process.restart = plan.restart;
  process.broker = plan.broker;
  const std::string program = plan.program.filename();
  process.gateway = program == "splatbus-gateway";
  process.streamer = program == "splatbus-streamer";
  process.cuda = plan.backend == "cuda";
  process.beats = plan.heartbeat_timeout_s > 0;
  process.start_timeout_s = plan.start_timeout_s;
  process.stop_timeout_s = plan.stop_timeout_s;
  process.environment.emplace("SPLATBUS_STOP_TIMEOUT_S", fmt::format("{}", plan.stop_timeout_s));
  process.readiness = plan.readiness;
  process.liveness = plan.liveness;
  if (program == "splatbus-trainer" && !parameter(process, "world").empty()) {
    process.has_world = true;
    set_parameter(process, "world", kWorldFolder);
  }
  return process;
}

}  // namespace

std::string unused_name(const DeployPlan& plan, std::string wanted) {
  const auto is_taken = [&](const DeployProcess& process) {
    return process.name == wanted || process.service == wanted;
  };
  while (std::ranges::any_of(plan.local, is_taken) || std::ranges::any_of(plan.remote, is_taken)) wanted += "-own";
  return wanted;
}

int whole_seconds(double seconds) {
  return std::max(1, static_cast<int>(std::ceil(seconds)));
}

int grace_seconds(double stop_timeout_s, int usual_s) {
  constexpr int kSlackS = 2;  // what a process takes after its own time to end is up
  return std::max(usual_s, whole_seconds(stop_timeout_s) + kSlackS);
}

std::map<std::string, std::set<std::string>> secrets_by_service(const std::vector<DeployProcess>& processes) {
  std::map<std::string, std::set<std::string>> files;
  for (const DeployProcess& process : processes) {
    if (!process.secrets.empty()) files[process.service].insert(process.secrets.begin(), process.secrets.end());
  }
  return files;
}

std::vector<std::string> probe_command(const Probe& probe) {
  if (probe.kind == Probe::Kind::Command) return probe.command;
  const char* const option = probe.kind == Probe::Kind::Tcp ? "--tcp" : "--http";
  return {"splatbus", "health", option, probe.target, "--timeout", fmt::format("{}", probe.timeout_s)};
}

std::vector<std::string> health_command(const DeployProcess& process, const std::string& name,
                                        const std::optional<Probe>& probe) {
  const std::vector<std::string> ask = probe ? probe_command(*probe) : std::vector<std::string>();
  if (!process.beats) return ask;
  // The broker's heartbeat is its own word, whatever the launch file calls it: that it answers is what there is to ask.
  std::vector<std::string> alive{"splatbus", "health"};
  const bool is_variable = name.starts_with('$');
  if (!process.broker && !is_variable) alive.push_back(name);
  if (ask.empty() && !is_variable) return alive;
  std::string line = shell_line(alive);
  if (is_variable) line += fmt::format(" \"{}\"", name);
  if (!ask.empty()) line += " && " + shell_line(ask);
  return {"sh", "-c", line};
}

DeployPlan plan_deployment(const LaunchFile& file, const fs::path& programs, const DeployOptions& options) {
  check_remote(file, options.remote);
  const LaunchPlan launch = plan_launch(file, bus::Address::parse(fmt::format("ipc://{}", kBusFolder)), programs);
  DeployPlan plan;
  plan.name = host_name(fs::path(file.path).stem().string());
  int streamer_port = options.streamer_port;
  for (const ProcessPlan& process : launch.processes) {
    const auto service = std::ranges::find_if(file.services, [&](const LaunchService& s) {
      return s.name == process.name || (s.replicas > 1 && process.name.starts_with(s.name + "-"));
    });
    DeployProcess placed = containerised(process, *service, programs);
    const auto bus = options.remote.find(service->name);
    const bool remote = bus != options.remote.end();
    for (const std::size_t index : process.after) placed.after.push_back(launch.processes[index].name);
    if (!process.broker && placed.beats && placed.after.empty() && !remote) placed.after.emplace_back("bus");
    if (placed.broker) place_broker(placed);
    if (placed.gateway) place_gateway(placed, options);
    if (placed.streamer) place_streamer(placed, remote ? options.streamer_port : streamer_port++);
    if (remote) place_client(placed, bus->second);
    (remote ? plan.remote : plan.local).push_back(std::move(placed));
  }
  // Only what is there is waited for: by an entry on another machine nobody of this one.
  std::set<std::string> names;
  for (const DeployProcess& process : plan.local) names.insert(process.name);
  for (auto* part : {&plan.local, &plan.remote}) {
    for (DeployProcess& process : *part) {
      std::erase_if(process.after,
                    [&](const std::string& name) { return part == &plan.remote || !names.contains(name); });
    }
  }
  return plan;
}

}  // namespace splatbus::cli
