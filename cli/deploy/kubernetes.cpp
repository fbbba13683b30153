#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>

#include "deploy_plan.h"
#include "yaml_text.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kSecret = "splatbus-keys";
constexpr const char* kPodSecretFolder = "/run/splatbus-secret";  // below /run/secrets Kubernetes mounts its own
constexpr int kPodGraceS = 15;
constexpr const char* kMemory = "8Gi";  // of slabs in /dev/shm and of the bus's folder, at most

Json labels(const DeployPlan& plan, const std::string& component) {
  return {{"app.kubernetes.io/name", plan.name},
          {"app.kubernetes.io/part-of", "splatbus"},
          {"app.kubernetes.io/component", component}};
}

/// Kubernetes takes $(NAME) for a variable of its own.
std::string plain(const std::string& text) {
  std::string out;
  for (std::size_t i = 0; i < text.size(); ++i) {
    out += text[i];
    if (text[i] == '$' && i + 1 < text.size() && text[i + 1] == '(') out += '$';
  }
  return out;
}

constexpr int kHeartbeatS = 10;  // between two looks at heartbeats, and the time that one may take

Json exec_probe(const std::vector<std::string>& command, int period_s, int timeout_s, int failures) {
  return {{"exec", {{"command", command}}},
          {"periodSeconds", period_s},
          {"timeoutSeconds", timeout_s},
          {"failureThreshold", failures}};
}

Json exec_probe(const std::vector<std::string>& command, const DeployProcess& process,
                const std::optional<Probe>& probe) {
  const int beat_s = process.beats ? kHeartbeatS : 0;
  if (!probe) return exec_probe(command, kHeartbeatS, beat_s, 3);
  return exec_probe(command, whole_seconds(probe->period_s), beat_s + whole_seconds(probe->timeout_s), probe->failures);
}

/// As the launch file has it: ready once `readiness` was good, in `start_timeout_s`; from then on `liveness` counts.
/// `name`: on the bus, or a variable that has it.
void add_probes(Json& container, const DeployProcess& process, const std::string& name) {
  const std::optional<Probe>& first = process.readiness ? process.readiness : process.liveness;
  if (const auto command = health_command(process, name, first); !command.empty()) {
    Json startup = exec_probe(command, process, first);
    const int period_s = startup["periodSeconds"].get<int>();
    const int times = whole_seconds(process.start_timeout_s / period_s) + (process.beats ? 3 : 0);
    startup["failureThreshold"] = std::max(3, times);
    container["startupProbe"] = startup;
  }
  if (const auto command = health_command(process, name, process.liveness); !command.empty()) {
    container["livenessProbe"] = exec_probe(command, process, process.liveness);
  }
  if (process.readiness) {
    const Probe& probe = *process.readiness;
    container["readinessProbe"] =
        exec_probe(probe_command(probe), whole_seconds(probe.period_s), whole_seconds(probe.timeout_s), probe.failures);
  } else if (process.gateway) {
    container["readinessProbe"] = {{"httpGet", {{"path", "/healthz"}, {"port", "http"}}}, {"periodSeconds", 5}};
  }
}

/// `name`: on the bus; of a set's replicas it is the pod's.
Json container_of(const DeployProcess& process, const DeployOptions& options, const std::string& name) {
  Json command = Json::array(), environment = Json::array(), ports = Json::array(), mounts = Json::array();
  const bool of_set = name != process.name;
  if (of_set) {
    environment.push_back({{"name", "POD_NAME"}, {"valueFrom", {{"fieldRef", {{"fieldPath", "metadata.name"}}}}}});
    environment.push_back({{"name", "SPLATBUS_SERVER_KEY"},
                           {"valueFrom", {{"secretKeyRef", {{"name", kSecret}, {"key", "server_public_key"}}}}}});
  }
  for (std::size_t i = 0; i < process.command.size(); ++i) {
    const std::string& word = process.command[i];
    const bool is_name = i > 0 && process.command[i - 1] == "--name";
    const bool is_address = word.starts_with("tcp_address=");
    if (of_set && is_name) {
      command.push_back(name);
    } else if (is_address) {
      command.push_back(fmt::format(
          "tcp_address={}", of_set ? fmt::format("{}.{}", name, process.service) : fmt::format("{}", process.service)));
    } else {
      command.push_back(plain(word));
    }
  }
  for (const auto& [key, value] : process.environment) environment.push_back({{"name", key}, {"value", plain(value)}});
  for (const DeployPort& port : process.ports) ports.push_back({{"name", port.name}, {"containerPort", port.port}});
  if (!of_set) mounts.push_back({{"name", "run"}, {"mountPath", kRunFolder}});
  if (!process.secrets.empty()) {
    mounts.push_back({{"name", "keys"}, {"mountPath", kKeyFolder}, {"subPath", process.service}, {"readOnly", true}});
  }
  if (!of_set) mounts.push_back({{"name", "shm"}, {"mountPath", "/dev/shm"}});
  if (process.has_world) mounts.push_back({{"name", "world"}, {"mountPath", kWorldFolder}});
  Json container{{"name", process.name}, {"image", options.image}, {"command", command}};
  if (!environment.empty()) container["env"] = environment;
  if (!ports.empty()) container["ports"] = ports;
  if (!mounts.empty()) container["volumeMounts"] = mounts;
  add_probes(container, process, of_set ? "$POD_NAME" : name);
  if (process.cuda) container["resources"] = {{"limits", {{"nvidia.com/gpu", 1}}}};
  return container;
}

Json memory(const char* name) {
  return {{"name", name}, {"emptyDir", {{"medium", "Memory"}, {"sizeLimit", kMemory}}}};
}

/// A pod of these processes, whose containers have one user. What is mounted is root's, and the user's by its group: a
/// folder in memory is not fit for a bus then, nor are secrets for keys. So the bus makes its own folder there, and a
/// container that runs first copies the keys to another, as files of the user's alone: a folder for each entry, which
/// its containers alone mount.
Json pod_of(const DeployPlan& plan, const DeployOptions& options, const std::vector<DeployProcess>& processes,
            const Json& containers) {
  double stop_timeout_s = 0;  // Kubernetes stops all containers of a pod at once
  for (const DeployProcess& process : processes) stop_timeout_s = std::max(stop_timeout_s, process.stop_timeout_s);
  Json pod{{"terminationGracePeriodSeconds", grace_seconds(stop_timeout_s, kPodGraceS)},
           {"automountServiceAccountToken", false},
           {"securityContext",
            {{"runAsNonRoot", true},
             {"runAsUser", kUser},
             {"runAsGroup", kUser},
             {"fsGroup", kUser},
             {"fsGroupChangePolicy", "OnRootMismatch"}}}};
  Json volumes = Json::array();
  if (const auto secrets = secrets_by_service(processes); !secrets.empty()) {
    std::string line;
    for (const auto& [entry, files] : secrets) {
      line += fmt::format("{0}install -d -m 0700 {1}/{2} && install -m 0600 -t {1}/{2}", line.empty() ? "" : " && ",
                          kKeyFolder, entry);
      for (const std::string& file : files) line += fmt::format(" {}/{}", kPodSecretFolder, file);
    }
    pod["initContainers"] =
        Json::array({{{"name", unused_name(plan, "keys")},
                      {"image", options.image},
                      {"command", {"sh", "-c", line}},
                      {"volumeMounts",
                       {{{"name", "keys"}, {"mountPath", kKeyFolder}},
                        {{"name", "secret"}, {"mountPath", kPodSecretFolder}, {"readOnly", true}}}}}});
    volumes.push_back({{"name", "secret"}, {"secret", {{"secretName", kSecret}, {"defaultMode", 0440}}}});
    volumes.push_back(memory("keys"));
  }
  pod["containers"] = containers;
  if (!volumes.empty()) pod["volumes"] = volumes;
  return pod;
}

Json pod_of_machine(const DeployPlan& plan, const DeployOptions& options) {
  Json containers = Json::array();
  for (const DeployProcess& process : plan.local) {
    Json container = container_of(process, options, process.name);
    for (Json& port : container["ports"]) {
      if (process.streamer) port["name"] = process.name.substr(0, 15);
    }
    if (container["ports"].is_null()) container.erase("ports");
    containers.push_back(container);
  }
  Json spec = pod_of(plan, options, plan.local, containers);
  Json& volumes = spec["volumes"];
  volumes.push_back(memory("run"));
  volumes.push_back(memory("shm"));
  for (const DeployProcess& process : plan.local) {
    if (process.has_world)
      volumes.push_back({{"name", "world"}, {"persistentVolumeClaim", {{"claimName", plan.name + "-world"}}}});
  }
  // Slabs go from process to process as descriptors, to whose owner the registry looks: one pod, one list of processes.
  spec["shareProcessNamespace"] = true;
  return {{"apiVersion", "apps/v1"},
          {"kind", "Deployment"},
          {"metadata", {{"name", plan.name}, {"labels", labels(plan, "machine")}}},
          {"spec",
           {{"replicas", 1},
            {"strategy", {{"type", "Recreate"}}},
            {"selector", {{"matchLabels", labels(plan, "machine")}}},
            {"template", {{"metadata", {{"labels", labels(plan, "machine")}}}, {"spec", spec}}}}}};
}

Json service(const DeployPlan& plan, const std::string& name, const std::string& component, const Json& ports,
             bool headless) {
  Json spec{{"selector", labels(plan, component)}, {"ports", ports}};
  if (headless) spec["clusterIP"] = "None";
  return {{"apiVersion", "v1"},
          {"kind", "Service"},
          {"metadata", {{"name", name}, {"labels", labels(plan, component)}}},
          {"spec", spec}};
}

Json port_entry(const std::string& name, int port) {
  return {{"name", name.substr(0, 15)}, {"port", port}, {"targetPort", port}};
}

Json set_of(const DeployPlan& plan, const DeployOptions& options, const DeployProcess& first, int replicas) {
  DeployProcess one = first;
  one.name = first.service;
  const Json spec = pod_of(plan, options, {one}, Json::array({container_of(one, options, "$(POD_NAME)")}));
  return {{"apiVersion", "apps/v1"},
          {"kind", "StatefulSet"},
          {"metadata", {{"name", first.service}, {"labels", labels(plan, first.service)}}},
          {"spec",
           {{"serviceName", first.service},
            {"replicas", replicas},
            {"podManagementPolicy", "Parallel"},
            {"selector", {{"matchLabels", labels(plan, first.service)}}},
            {"template", {{"metadata", {{"labels", labels(plan, first.service)}}}, {"spec", spec}}}}}};
}

}  // namespace

std::string kubernetes_text(const DeployPlan& plan, const DeployOptions& options) {
  std::vector<Json> documents{pod_of_machine(plan, options)};
  Json streams = Json::array();
  for (const DeployProcess& process : plan.local) {
    if (process.broker && !process.ports.empty()) {
      Json ports = Json::array();
      for (const DeployPort& port : process.ports) ports.push_back(port_entry(port.name, port.port));
      documents.push_back(service(plan, process.name, "machine", ports, false));
    }
    if (process.gateway) {
      documents.push_back(
          service(plan, process.name, "machine", Json::array({port_entry("http", process.ports.front().port)}), false));
    }
    for (const DeployPort& port : process.ports) {
      if (process.streamer) streams.push_back(port_entry(process.name, port.port));
    }
    if (process.has_world) {
      documents.push_back(
          {{"apiVersion", "v1"},
           {"kind", "PersistentVolumeClaim"},
           {"metadata", {{"name", plan.name + "-world"}, {"labels", labels(plan, "machine")}}},
           {"spec",
            {{"accessModes", Json::array({"ReadWriteOnce"})}, {"resources", {{"requests", {{"storage", "50Gi"}}}}}}}});
    }
  }
  std::vector<std::string> sets;
  for (const DeployProcess& process : plan.remote) {
    if (std::ranges::find(sets, process.service) != sets.end()) continue;
    sets.push_back(process.service);
    const auto replicas = static_cast<int>(std::ranges::count(plan.remote, process.service, &DeployProcess::service));
    documents.push_back(set_of(plan, options, process, replicas));
    Json ports = Json::array();
    for (const DeployPort& port : process.ports) ports.push_back(port_entry(port.name, port.port));
    documents.push_back(service(plan, process.service, process.service, ports, true));
    if (!ports.empty()) continue;
    documents.back()["spec"].erase("ports");
  }
  if (!streams.empty()) {
    const auto first = std::ranges::find_if(plan.local, &DeployProcess::streamer);
    documents.push_back(service(plan, first->service, "machine", streams, false));
  }
  std::string text =
      "# Written by 'splatbus export kubernetes'. Keys and tokens are those of the secret splatbus-keys:\n"
      "# docs/scale.md.\n";
  // A container's share of the processor comes of what it requests, in cores, which a nice value does not say.
  std::set<std::string> nice;
  for (const auto* processes : {&plan.local, &plan.remote}) {
    for (const DeployProcess& process : *processes) {
      if (process.nice > 0) nice.insert(process.service);
    }
  }
  if (!nice.empty()) text += fmt::format("# Kubernetes knows no nice, which these had: {}.\n", fmt::join(nice, ", "));
  for (const Json& document : documents) text += "---\n" + yaml_text(document);
  return text;
}

}  // namespace splatbus::cli
