#pragma once

#include <cstddef>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "bus/context.h"
#include "launch_file.h"

namespace splatbus::cli {

/// In the environment of each process: the launch file that has its entry, and the entry's name.
inline constexpr const char* kLaunchFileVariable = "SPLATBUS_LAUNCH_FILE";
inline constexpr const char* kLaunchServiceVariable = "SPLATBUS_LAUNCH_SERVICE";

/// One process to run and look after.
struct ProcessPlan {
  std::string name;     ///< source on the bus
  std::string service;  ///< entry of the launch file that it is a replica of
  int replica = 1;
  std::filesystem::path program;
  std::vector<std::string> arguments;
  std::map<std::string, std::string> environment;
  int nice = 0;  ///< added to ours: what it leaves of the processor to others
  RestartPolicy restart = RestartPolicy::OnFailure;
  int restart_attempts = 8;      ///< ends in a row after which it has failed for good; 0: never
  double restart_window_s = 10;  ///< ready for longer than that: earlier ends are forgotten
  double restart_delay_s = 0.1;  ///< before the second start; doubles with every attempt
  double restart_max_delay_s = 8;
  std::vector<std::size_t> after;  ///< earlier entries of the plan
  double heartbeat_timeout_s = 5;  ///< 0: ready as soon as it runs
  double start_timeout_s = 30;
  double stop_timeout_s = 3;                 ///< from SIGTERM to SIGKILL
  std::optional<Probe> readiness, liveness;  ///< besides heartbeats
  bool broker = false;
  std::string backend;  ///< cpu, cuda or auto, as SPLATBUS_BACKEND; empty: what that variable says here
};

/// Sets a parameter of a process, in the place of an earlier value.
void set_parameter(ProcessPlan& process, const std::string& key, const std::string& value);

/// What a launch file comes to: processes, each after those that it waits for; the broker first.
struct LaunchPlan {
  bus::Address bus;
  std::vector<ProcessPlan> processes;
};

/// Where the programs of this build lie: beside the running program.
[[nodiscard]] std::filesystem::path program_directory();

/// Makes replicas, finds programs, orders. In parameters, args and environment `${name}` is the process's name,
/// `${replica}` its number from 1, `${bus_dir}` the folder of an ipc bus. Throws LaunchError with every problem.
[[nodiscard]] LaunchPlan plan_launch(const LaunchFile& file, const bus::Address& bus,
                                     const std::filesystem::path& programs);

/// Names under which the processes of a file send heartbeats on its bus, but for the broker's.
[[nodiscard]] std::vector<std::string> heartbeat_sources(const LaunchFile& file);

/// Throws LaunchError with the place when a service shall use CUDA and this machine or build cannot.
void check_backends(const LaunchFile& file);

/// launch/NAME under the working folder, or under a folder above the program's. Throws std::runtime_error.
[[nodiscard]] std::filesystem::path default_launch_file(const std::string& name);

}  // namespace splatbus::cli
