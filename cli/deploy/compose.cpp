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
constexpr int kComposeGraceS = 10;                       // of Docker where nothing is said
constexpr const char* kComplete = "complete";  // a file of the container's that copies them, once all are there

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

using Secrets = std::map<std::string, std::set<std::string>>;

/// Its own volume for each entry: who reads one key does not read all.
std::string key_volume(const std::string& entry) {
  return "keys-" + entry;
}

/// A container that sleeps, and holds volumes in memory while those come and go who use them. Secrets are the host's
/// files there, with its owners and modes, so that root copies them: again whenever it starts.
Json holder_of(const DeployOptions& options, const Secrets& secrets) {
  Json holder{{"image", options.image}, {"init", true}, {"restart", "always"}};
  if (secrets.empty()) {
    holder["user"] = fmt::format("{0}:{0}", kUser);
    holder["command"] = {"sleep", "infinity"};
    return holder;
  }
  const std::string complete = fmt::format("{}/{}", kRunFolder, kComplete);
  std::set<std::string> all;
  std::string line = fmt::format("rm -f {}", complete);
  for (const auto& [entry, files] : secrets) {
    line += fmt::format(" && install -o {0} -g {0} -m 0600 -t {1}/{2}", kUser, kKeyFolder, entry);
    for (const std::string& file : files) line += fmt::format(" {}/{}", kComposeSecrets, file);
    all.insert(files.begin(), files.end());
    holder["volumes"].push_back(fmt::format("{}:{}/{}", key_volume(entry), kKeyFolder, entry));
  }
  holder["user"] = "0:0";
  holder["command"] = {"sh", "-c", fmt::format("{} && touch {} && exec sleep infinity", line, complete)};
  holder["secrets"] = all;
  holder["healthcheck"] = {
      {"test", {"CMD", "test", "-e", complete}}, {"interval", "2s"}, {"timeout", "2s"}, {"retries", 15}};
  return holder;
}

/// That whose processes' numbers and ipc the others of its host have: slabs go from process to process as descriptors,
/// to whose owner the registry looks, and CUDA's share memory by ipc. It ends with none of them.
Json machine_of(const DeployOptions& options, const Secrets& secrets) {
  Json machine = holder_of(options, secrets);
  machine["ipc"] = "shareable";
  machine["shm_size"] = "2gb";
  machine["volumes"].push_back(fmt::format("run:{}", kBusFolder));
  return machine;
}

/// What all services of the file have in common.
struct Surroundings {
  const DeployOptions& options;
  std::string machine;                   ///< name of the container that the others of its host live in
  std::map<std::string, bool> is_asked;  ///< by process: it has a health
};

/// `holder`: the container that has to be there first, if any.
Json service_of(const DeployProcess& process, const Surroundings& around, bool remote, const std::string& holder,
                bool holds_keys) {
  Json environment = Json::object();
  for (const auto& [key, value] : process.environment) environment[key] = literal(value);
  Json service{{"image", around.options.image},
               {"user", fmt::format("{0}:{0}", kUser)},
               {"command", literals(process.command)},
               {"restart", restart_of(process.restart)},
               {"stop_grace_period", seconds(grace_seconds(process.stop_timeout_s, kComposeGraceS))}};
  // A step of nice(2) is a factor of 1.25 of what a process gets of a processor that others want too.
  if (process.nice > 0) service["cpu_shares"] = std::lround(1024 / std::pow(1.25, process.nice));
  if (remote) environment["SPLATBUS_SERVER_KEY"] = "${SPLATBUS_SERVER_KEY:?the bus's public key}";
  if (!environment.empty()) service["environment"] = environment;
  if (!holder.empty()) {
    service["depends_on"][holder] = {{"condition", holds_keys ? "service_healthy" : "service_started"}};
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
  if (!process.secrets.empty()) volumes.push_back(fmt::format("{}:{}:ro", key_volume(process.service), kKeyFolder));
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
  Surroundings around{.options = options, .machine = unused_name(plan, "machine"), .is_asked = {}};
  for (const auto* part : {&plan.local, &plan.remote}) {
    for (const DeployProcess& process : *part) around.is_asked[process.name] = !health_of(process).is_null();
  }
  const Json memory{{"driver_opts",
                     {{"type", "tmpfs"}, {"device", "tmpfs"}, {"o", fmt::format("mode=0700,uid={0},gid={0}", kUser)}}}};
  Json services = Json::object(), secrets = Json::object(), volumes{{"run", memory}};
  const auto declare = [&](const Secrets& held) {
    for (const auto& [entry, files] : held) {
      volumes[key_volume(entry)] = memory;
      for (const std::string& file : files) secrets[file] = {{"file", "./secrets/" + file}};
    }
  };
  const Secrets here = secrets_by_service(plan.local);
  declare(here);
  services[around.machine] = machine_of(options, here);
  for (const DeployProcess& process : plan.local) {
    services[process.name] = service_of(process, around, false, around.machine, !here.empty());
    if (process.has_world) volumes["world"] = Json::object();
  }
  // Each entry elsewhere has a holder of its own: no other key has to be on its host.
  const Secrets elsewhere = secrets_by_service(plan.remote);
  declare(elsewhere);
  for (const DeployProcess& process : plan.remote) {
    const auto own = elsewhere.find(process.service);
    const std::string holder = own == elsewhere.end() ? "" : unused_name(plan, around.machine + "-" + process.service);
    if (!holder.empty()) services[holder] = holder_of(options, {*own});
    services[process.name] = service_of(process, around, true, holder, true);
    if (process.has_world) volumes["world"] = Json::object();
  }
  Json file{{"services", services}, {"volumes", volumes}};
  if (!secrets.empty()) file["secrets"] = secrets;
  return fmt::format(
      "# Written by 'splatbus export compose'. Keys and tokens are read from ./secrets: docs/scale.md.\n{}",
      yaml_text(file));
}

}  // namespace splatbus::cli
