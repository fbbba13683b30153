#include <fmt/format.h>

#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "deploy_plan.h"
#include "yaml_text.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::ordered_json;

/// Compose takes $ for a variable of its own.
std::string literal(const std::string& text) {
  std::string out;
  for (const char c : text) out += c == '$' ? "$$" : std::string(1, c);
  return out;
}

const char* restart_of(RestartPolicy policy) {
  return policy == RestartPolicy::Always ? "always" : policy == RestartPolicy::OnFailure ? "on-failure" : "no";
}

Json health_of(const DeployProcess& process) {
  return {{"test", {"CMD", "splatbus", "health", process.name}},
          {"interval", "10s"},
          {"timeout", "10s"},
          {"retries", 3},
          {"start_period", fmt::format("{}s", static_cast<int>(process.start_timeout_s))}};
}

/// The host's ports: what is meant for people is published to this machine alone.
Json ports_of(const DeployProcess& process) {
  Json ports = Json::array();
  for (const DeployPort& port : process.ports) {
    ports.push_back(fmt::format("{}{}:{}", process.gateway ? "127.0.0.1:" : "", port.port, port.port));
  }
  return ports;
}

Json service_of(const DeployProcess& process, const DeployOptions& options, const std::map<std::string, bool>& beats,
                bool remote) {
  Json command = Json::array();
  for (const std::string& word : process.command) command.push_back(literal(word));
  Json environment = Json::object();
  for (const auto& [key, value] : process.environment) environment[key] = literal(value);
  Json service{{"image", options.image},
               {"command", command},
               {"init", true},
               {"restart", restart_of(process.restart)},
               {"stop_grace_period", "10s"}};
  // A step of nice(2) is a factor of 1.25 of what a process gets of a processor that others want too.
  if (process.nice > 0) service["cpu_shares"] = std::lround(1024 / std::pow(1.25, process.nice));
  if (remote) environment["SPLATBUS_SERVER_KEY"] = "${SPLATBUS_SERVER_KEY:?the bus's public key}";
  if (!environment.empty()) service["environment"] = environment;
  if (!process.after.empty()) {
    for (const std::string& name : process.after) {
      service["depends_on"][name] = {{"condition", beats.at(name) ? "service_healthy" : "service_started"}};
    }
  }
  if (!remote) {
    service["volumes"] = {fmt::format("run:{}", kBusFolder)};
    // Slabs go from process to process as descriptors, to whose owner the registry looks; CUDA's share memory by ipc.
    service["ipc"] = process.broker ? "shareable" : "service:bus";
    if (!process.broker) service["pid"] = "service:bus";
    if (process.broker) service["shm_size"] = "2gb";
  }
  if (process.has_world) service["volumes"].push_back(fmt::format("world:{}", kWorldFolder));
  if (process.beats) service["healthcheck"] = health_of(process);
  if (!process.ports.empty() && !remote) service["ports"] = ports_of(process);
  if (!process.secrets.empty()) service["secrets"] = process.secrets;
  if (process.cuda) {
    service["deploy"]["resources"]["reservations"]["devices"] =
        Json::array({{{"driver", "nvidia"}, {"count", 1}, {"capabilities", Json::array({"gpu"})}}});
  }
  return service;
}

}  // namespace

std::string compose_text(const DeployPlan& plan, const DeployOptions& options) {
  Json services = Json::object(), secrets = Json::object();
  std::set<std::string> files;
  std::map<std::string, bool> beats;
  bool has_world = false;
  for (const auto* part : {&plan.local, &plan.remote}) {
    for (const DeployProcess& process : *part) beats[process.name] = process.beats;
  }
  for (const auto* part : {&plan.local, &plan.remote}) {
    for (const DeployProcess& process : *part) {
      services[process.name] = service_of(process, options, beats, part == &plan.remote);
      files.insert(process.secrets.begin(), process.secrets.end());
      has_world = has_world || process.has_world;
    }
  }
  for (const std::string& file : files) secrets[file] = {{"file", "./secrets/" + file}};
  Json volumes{{"run", {{"driver_opts", {{"type", "tmpfs"}, {"device", "tmpfs"}, {"o", "mode=0700"}}}}}};
  if (has_world) volumes["world"] = Json::object();
  Json file{{"services", services}, {"volumes", volumes}};
  if (!secrets.empty()) file["secrets"] = secrets;
  return fmt::format(
      "# Written by 'splatbus export compose'. Keys and tokens are read from ./secrets: docs/scale.md.\n{}",
      yaml_text(file));
}

}  // namespace splatbus::cli
