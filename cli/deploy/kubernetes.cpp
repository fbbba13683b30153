#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "deploy_plan.h"
#include "yaml_text.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kSecret = "splatbus-keys";
constexpr const char* kShmBytes = "8Gi";  // of slabs in /dev/shm and of the bus's folder, at most

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

Json probe(const std::string& name) {
  return {{"exec", {{"command", {"splatbus", "health", name}}}},
          {"periodSeconds", 10},
          {"timeoutSeconds", 10},
          {"failureThreshold", 3}};
}

Json ready(const DeployProcess& process) {
  if (!process.gateway) return {};
  return {{"httpGet", {{"path", "/healthz"}, {"port", "http"}}}, {"periodSeconds", 5}};
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
  if (!of_set) {
    mounts.push_back({{"name", "run"}, {"mountPath", kBusFolder}});
    mounts.push_back({{"name", "shm"}, {"mountPath", "/dev/shm"}});
  }
  if (process.has_world) mounts.push_back({{"name", "world"}, {"mountPath", kWorldFolder}});
  if (!process.secrets.empty()) {
    mounts.push_back({{"name", "keys"}, {"mountPath", kSecretFolder}, {"readOnly", true}});
  }
  Json container{{"name", process.name}, {"image", options.image}, {"command", command}};
  if (!environment.empty()) container["env"] = environment;
  if (!ports.empty()) container["ports"] = ports;
  if (!mounts.empty()) container["volumeMounts"] = mounts;
  if (process.beats) {
    container["startupProbe"] = probe(name);
    container["startupProbe"]["failureThreshold"] = std::max(3, static_cast<int>(process.start_timeout_s / 10) + 3);
    container["livenessProbe"] = probe(name);
  }
  if (const Json readiness = ready(process); !readiness.is_null()) container["readinessProbe"] = readiness;
  if (process.cuda) container["resources"] = {{"limits", {{"nvidia.com/gpu", 1}}}};
  return container;
}

Json keys_volume() {
  return {{"name", "keys"}, {"secret", {{"secretName", kSecret}, {"defaultMode", 0400}}}};
}

bool any_secret(const std::vector<DeployProcess>& processes) {
  return std::ranges::any_of(processes, [](const DeployProcess& p) { return !p.secrets.empty(); });
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
  const auto memory = [](const char* name) {
    return Json{{"name", name}, {"emptyDir", {{"medium", "Memory"}, {"sizeLimit", kShmBytes}}}};
  };
  Json volumes = Json::array({memory("run"), memory("shm")});
  if (any_secret(plan.local)) volumes.push_back(keys_volume());
  for (const DeployProcess& process : plan.local) {
    if (process.has_world)
      volumes.push_back({{"name", "world"}, {"persistentVolumeClaim", {{"claimName", plan.name + "-world"}}}});
  }
  // Slabs go from process to process as descriptors, to whose owner the registry looks: one pod, one list of processes.
  Json spec{{"shareProcessNamespace", true},
            {"terminationGracePeriodSeconds", 15},
            {"containers", containers},
            {"volumes", volumes}};
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
  Json container = container_of(one, options, "$(POD_NAME)");
  // A probe's command knows no variables but by a shell.
  for (const char* which : {"startupProbe", "livenessProbe"}) {
    if (container.contains(which)) {
      container[which]["exec"]["command"] = {"sh", "-c", "exec splatbus health \"$POD_NAME\""};
    }
  }
  Json spec{{"terminationGracePeriodSeconds", 15}, {"containers", Json::array({container})}};
  if (!one.secrets.empty()) spec["volumes"] = Json::array({keys_volume()});
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
  for (const Json& document : documents) text += "---\n" + yaml_text(document);
  return text;
}

}  // namespace splatbus::cli
