#include <fmt/format.h>

#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>

#include "deploy_plan.h"
#include "yaml_text.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kComposeSecrets = "/run/secrets";  // where compose mounts them
constexpr const char* kComplete = "complete";            // a file beside the keys, once all are there

/// Compose takes $ for a variable of its own.
std::string literal(const std::string& text) {
  std::string out;
  for (const char c : text) out += c == '$' ? "$$" : std::string(1, c);
  return out;
}

Json literals(const std::vector<std::string>& words) {
  Json list = Json::array();
  for (const std::string& word : words) list.push_back(literal(word));
  return list;
}

const char* restart_of(RestartPolicy policy) {
  return policy == RestartPolicy::Always ? "always" : policy == RestartPolicy::OnFailure ? "on-failure" : "no";
}

std::string seconds(int count) {
  return fmt::format("{}s", count);
}

/// A container has one health, which those wait for that come after it. Nothing is restarted for it.
Json health_of(const DeployProcess& process) {
  const std::optional<Probe>& probe = process.readiness ? process.readiness : process.liveness;
  const Json command = literals(health_command(process, process.name, probe));
  if (command.empty()) return {};
  Json test = Json::array({"CMD"});
  test.insert(test.end(), command.begin(), command.end());
  constexpr int kLookEveryS = 10;
  const int patience_s = (process.beats ? kLookEveryS : 0) + (probe ? whole_seconds(probe->timeout_s) : 0);
  return {{"test", test},
          {"interval", seconds(probe ? whole_seconds(probe->period_s) : kLookEveryS)},
          {"timeout", seconds(patience_s)},
          {"retries", probe ? probe->failures : 3},
          {"start_period", seconds(whole_seconds(process.start_timeout_s))}};
}

/// The host's ports: what is meant for people is published to this machine alone.
Json ports_of(const DeployProcess& process) {
  Json ports = Json::array();
  for (const DeployPort& port : process.ports) {
    ports.push_back(fmt::format("{}{}:{}", process.gateway ? "127.0.0.1:" : "", port.port, port.port));
  }
  return ports;
}

/// The container whose processes' numbers and ipc the others have: slabs go from process to process as descriptors, to
/// whose owner the registry looks, and CUDA's share memory by ipc. It ends with none of them, and it holds the volumes
/// in memory while they come and go. Secrets are the host's files there, with its owners and modes, so that root copies
/// them: again whenever it starts.
Json machine_of(const DeployOptions& options, const std::set<std::string>& files) {
  Json machine{{"image", options.image}, {"init", true},
               {"restart", "always"},    {"ipc", "shareable"},
               {"shm_size", "2gb"},      {"volumes", Json::array({fmt::format("run:{}", kBusFolder)})}};
  if (files.empty()) {
    machine["user"] = fmt::format("{0}:{0}", kUser);
    machine["command"] = {"sleep", "infinity"};
    return machine;
  }
  std::string sources;
  for (const std::string& file : files) sources += fmt::format(" {}/{}", kComposeSecrets, file);
  const std::string complete = fmt::format("{}/{}", kKeyFolder, kComplete);
  machine["user"] = "0:0";
  machine["command"] = {"sh", "-c",
                        fmt::format("rm -f {0} && install -o {1} -g {1} -m 0600 -t {2}{3} && touch {0} && "
                                    "exec sleep infinity",
                                    complete, kUser, kKeyFolder, sources)};
  machine["volumes"].push_back(fmt::format("keys:{}", kKeyFolder));
  machine["secrets"] = files;
  machine["healthcheck"] = {
      {"test", {"CMD", "test", "-e", complete}}, {"interval", "2s"}, {"timeout", "2s"}, {"retries", 15}};
  return machine;
}

/// What all services of the file have in common.
struct Surroundings {
  const DeployOptions& options;
  std::string machine;                   ///< name of the container that the others live in
  bool has_keys;                         ///< which it copies first
  std::map<std::string, bool> is_asked;  ///< by process: it has a health
};

Json service_of(const DeployProcess& process, const Surroundings& around, bool remote) {
  Json environment = Json::object();
  for (const auto& [key, value] : process.environment) environment[key] = literal(value);
  Json service{{"image", around.options.image},
               {"user", fmt::format("{0}:{0}", kUser)},
               {"command", literals(process.command)},
               {"restart", restart_of(process.restart)},
               {"stop_grace_period", seconds(whole_seconds(process.stop_timeout_s))}};
  // A step of nice(2) is a factor of 1.25 of what a process gets of a processor that others want too.
  if (process.nice > 0) service["cpu_shares"] = std::lround(1024 / std::pow(1.25, process.nice));
  if (remote) environment["SPLATBUS_SERVER_KEY"] = "${SPLATBUS_SERVER_KEY:?the bus's public key}";
  if (!environment.empty()) service["environment"] = environment;
  if (!remote || !process.secrets.empty()) {
    service["depends_on"][around.machine] = {{"condition", around.has_keys ? "service_healthy" : "service_started"}};
  }
  for (const std::string& name : process.after) {
    service["depends_on"][name] = {{"condition", around.is_asked.at(name) ? "service_healthy" : "service_started"}};
  }
  Json volumes = Json::array();
  if (remote) {
    service["init"] = true;  // in numbers of its own it would be the first process, whom the kernel treats otherwise
  } else {
    service["pid"] = fmt::format("service:{}", around.machine);
    service["ipc"] = fmt::format("service:{}", around.machine);
    volumes.push_back(fmt::format("run:{}", kBusFolder));
  }
  if (!process.secrets.empty()) volumes.push_back(fmt::format("keys:{}:ro", kKeyFolder));
  if (process.has_world) volumes.push_back(fmt::format("world:{}", kWorldFolder));
  if (!volumes.empty()) service["volumes"] = volumes;
  if (const Json health = health_of(process); !health.is_null()) service["healthcheck"] = health;
  if (!process.ports.empty() && !remote) service["ports"] = ports_of(process);
  if (process.cuda) {
    service["deploy"]["resources"]["reservations"]["devices"] =
        Json::array({{{"driver", "nvidia"}, {"count", 1}, {"capabilities", Json::array({"gpu"})}}});
  }
  return service;
}

}  // namespace

std::string compose_text(const DeployPlan& plan, const DeployOptions& options) {
  std::set<std::string> files;
  bool has_world = false;
  Surroundings around{.options = options, .machine = unused_name(plan, "machine"), .has_keys = false, .is_asked = {}};
  for (const auto* part : {&plan.local, &plan.remote}) {
    for (const DeployProcess& process : *part) {
      around.is_asked[process.name] = !health_of(process).is_null();
      files.insert(process.secrets.begin(), process.secrets.end());
      has_world = has_world || process.has_world;
    }
  }
  around.has_keys = !files.empty();
  Json services = Json::object(), secrets = Json::object();
  services[around.machine] = machine_of(options, files);
  for (const auto* part : {&plan.local, &plan.remote}) {
    for (const DeployProcess& process : *part) {
      services[process.name] = service_of(process, around, part == &plan.remote);
    }
  }
  for (const std::string& file : files) secrets[file] = {{"file", "./secrets/" + file}};
  const Json memory{{"driver_opts",
                     {{"type", "tmpfs"}, {"device", "tmpfs"}, {"o", fmt::format("mode=0700,uid={0},gid={0}", kUser)}}}};
  Json volumes{{"run", memory}};
  if (around.has_keys) volumes["keys"] = memory;
  if (has_world) volumes["world"] = Json::object();
  Json file{{"services", services}, {"volumes", volumes}};
  if (!secrets.empty()) file["secrets"] = secrets;
  return fmt::format(
      "# Written by 'splatbus export compose'. Keys and tokens are read from ./secrets: docs/scale.md.\n{}",
      yaml_text(file));
}

}  // namespace splatbus::cli
