#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "launch_file.h"
#include "launch_plan.h"

namespace splatbus::cli {

/// A port that a container listens on.
struct DeployPort {
  std::string name;
  int port = 0;
};

/// A process of a launch file as it runs in a container.
struct DeployProcess {
  std::string name;                  ///< source on the bus
  std::string service;               ///< entry of the launch file: that of replicas is the same
  std::vector<std::string> command;  ///< the program, found by PATH where it is one of ours, and its arguments
  std::map<std::string, std::string> environment;
  std::vector<std::string> after;    ///< names of processes
  std::vector<std::string> secrets;  ///< files of kKeyFolder that it reads
  std::vector<DeployPort> ports;
  int nice = 0;
  RestartPolicy restart = RestartPolicy::OnFailure;
  bool broker = false, gateway = false, streamer = false, cuda = false, beats = true, has_world = false;
  double start_timeout_s = 30, stop_timeout_s = 3;
  std::optional<Probe> readiness, liveness;  ///< besides heartbeats
};

/// Processes of one launch file: those on its bus, which lies in memory and wants them on one machine, and those that
/// reach the bus over tcp, which run anywhere.
struct DeployPlan {
  std::string name;  ///< of the file, fit for a host's name
  std::vector<DeployProcess> local, remote;
};

struct DeployOptions {
  std::string image = "splatbus";
  int gateway_port = 7680;                    ///< published
  int streamer_port = 7600;                   ///< of the first streamer; the next has the next
  std::map<std::string, std::string> remote;  ///< by entry: the bus over tcp that it uses from another machine
};

/// Who all containers run as: the user splatbus of the image, whom its Dockerfile names.
inline constexpr int kUser = 10001;
// A bus's folder has to be its user's alone, and so do key files. What orchestrators mount is neither: key files are
// copied from where secrets are mounted, by somebody who may read them there.
inline constexpr const char* kRunFolder = "/run/splatbus";
inline constexpr const char* kBusFolder = "/run/splatbus/bus";
inline constexpr const char* kKeyFolder = "/run/splatbus/keys";
inline constexpr const char* kWorldFolder = "/var/lib/splatbus/world";

/// Where streamers listen over tcp, and where a bus over tcp is reached, they take keys: server_key, allowed, and for
/// clients client_key, with the server's public key in SPLATBUS_SERVER_KEY. A gateway, which is reached from outside of
/// its container, takes tokens. Throws LaunchError.
[[nodiscard]] DeployPlan plan_deployment(const LaunchFile& file, const std::filesystem::path& programs,
                                         const DeployOptions& options);

/// A name for a container of our own, which no process of the plan has: `wanted`, or that with letters behind it.
[[nodiscard]] std::string unused_name(const DeployPlan& plan, std::string wanted);

/// A probe of the launch file as a command that ends with 0 when it is good.
[[nodiscard]] std::vector<std::string> probe_command(const Probe& probe);

/// The command by which an orchestrator asks whether a process is well: by its heartbeat at the broker, where it sends
/// any, and by a probe. Empty where there is nothing to ask. `name`: on the bus, or a variable of a shell that has it.
[[nodiscard]] std::vector<std::string> health_command(const DeployProcess& process, const std::string& name,
                                                      const std::optional<Probe>& probe);

/// In whole seconds, as orchestrators count: not less.
[[nodiscard]] int whole_seconds(double seconds);

/// From an orchestrator's SIGTERM to its SIGKILL: not before the process's own time is up, nor sooner than
/// `usual_s`.
[[nodiscard]] int grace_seconds(double stop_timeout_s, int usual_s);

/// Files of kKeyFolder that each entry's processes read, of those that read any.
[[nodiscard]] std::map<std::string, std::set<std::string>> secrets_by_service(
    const std::vector<DeployProcess>& processes);

/// As a docker compose file, by the Compose specification.
[[nodiscard]] std::string compose_text(const DeployPlan& plan, const DeployOptions& options);

/// As Kubernetes manifests, one document after the other: a pod for what shares memory, a stateful set for each remote
/// entry, and services before streamers, bus and gateway.
[[nodiscard]] std::string kubernetes_text(const DeployPlan& plan, const DeployOptions& options);

}  // namespace splatbus::cli
