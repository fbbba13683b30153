#pragma once

#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "control_server.h"
#include "launch_file.h"
#include "supervisor.h"

namespace splatbus::cli {

/// What the operator's verbs work on. Outlives the server.
struct Operated {
  Supervisor& supervisor;
  LaunchFile file;  ///< with what the command line changed, and scale, swap and save since; by whose turn it is
  bus::Address bus;
  std::string log_folder;      ///< empty: there are no log files
  std::function<void()> stop;  ///< asks the supervisor to stop everything
  std::function<std::int64_t()> now_ns = bus::now_ns;
  std::shared_ptr<std::timed_mutex> turn = std::make_shared<std::timed_mutex>();
};

/// For the verbs that read and change the launch file in memory: one at a time. Throws std::runtime_error when others
/// take longer than `wait_s`.
[[nodiscard]] std::unique_lock<std::timed_mutex> take_turn(const Operated& operated, double wait_s,
                                                           const ControlServer::Tell& tell);

/// Names of the processes that "trainer", "streamer" (all its replicas) or "streamer-2" mean. Throws std::runtime_error
/// that names the nearest, or what there is.
[[nodiscard]] std::vector<std::string> processes_of(const std::vector<ProcessStatus>& all, const std::string& name);

/// status, start, stop, restart, scale, save (of a parameter), wait and down.
void add_operator_verbs(ControlServer& server, const std::shared_ptr<Operated>& operated);

}  // namespace splatbus::cli
