#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <string_view>
#include <vector>

#include "bus/clock.h"
#include "bus/subscriber.h"
#include "child_process.h"
#include "launch_plan.h"

namespace splatbus::cli {

enum class ProcessState { Waiting, Starting, Running, BackOff, Ended, Failed };

[[nodiscard]] const char* to_string(ProcessState state);

struct ProcessStatus {
  std::string name;
  ProcessState state = ProcessState::Waiting;
  pid_t pid = 0;  ///< 0 when it does not run
  int restarts = 0;
  std::string detail;                      ///< why it waits or failed, or what its heartbeat says
  std::map<std::string, double> counters;  ///< of its last heartbeat
};

/// Seconds until a process is started again that ended `attempts` times in a row, at least once.
[[nodiscard]] double back_off_s(int attempts);

/// Runs a launch plan: starts each process when those before it are ready (first heartbeat), passes its output on, and
/// starts it again with back-off when it ends, when it sends no heartbeat any more, or never became ready. A bus that
/// is away stops nobody: heartbeats are only missed while the broker's own arrive.
class Supervisor {
 public:
  /// A line that a process wrote, or, with `own`, that the supervisor says about it.
  using Output = std::function<void(const std::string& process, const std::string& line, bool own)>;
  /// CLOCK_MONOTONIC nanoseconds, or what a test takes for them.
  using Clock = std::function<std::int64_t()>;

  Supervisor(LaunchPlan plan, Output output, Clock now_ns = bus::now_ns);
  ~Supervisor();  ///< kills what still runs
  Supervisor(const Supervisor&) = delete;
  Supervisor& operator=(const Supervisor&) = delete;

  /// Until `stop` is asked for, or nothing is left to run. Then stops every process after those that depend on it:
  /// SIGTERM, and SIGKILL to what does not go, at once when `kill` is asked for. False when a process failed for good.
  /// Processes die with the thread that calls this.
  bool run(const std::stop_token& stop, const std::stop_token& kill);

  /// Any thread.
  [[nodiscard]] std::vector<ProcessStatus> status() const;
  /// The first process that failed for good, and why. Any thread.
  [[nodiscard]] std::optional<std::string> failure() const;

 private:
  struct Process {
    ProcessPlan plan;
    ProcessStatus status;
    std::optional<ChildProcess> child;
    std::int64_t started_ns = 0;
    std::int64_t ready_ns = 0;
    std::int64_t last_sign_ns = 0;   ///< last heartbeat, or the broker's return
    std::int64_t next_start_ns = 0;  ///< when in BackOff
    std::int64_t terminate_ns = 0;   ///< when SIGTERM was sent, 0 before
    int attempts = 0;                ///< ends in a row without a healthy while between them
    bool was_ready = false;          ///< in any life: what waits for it may go
  };

  void wait_for_events();
  void pass_output(Process& process, bool rest);
  void take(const wire::Heartbeat& heartbeat, std::string_view source);
  [[nodiscard]] Process* sender(std::string_view source, pid_t pid);
  void reap(Process& process, bool stopping);
  void ended(Process& process, const ExitStatus& status);
  void start_what_is_due();
  void start(Process& process);
  /// With back-off; fails it after too many attempts in a row.
  void start_later(Process& process, const std::string& reason);
  void ready(Process& process);
  void check_signs_of_life();
  /// The time up to which silence means something: the broker's own last heartbeat, 0 while it is away.
  [[nodiscard]] std::int64_t bus_heard_until() const;
  [[nodiscard]] bool anything_to_do() const;
  void terminate_in_order(bool kill);
  void fail(Process& process, const std::string& reason);
  void say(const Process& process, const std::string& text) const;
  void publish_status();

  std::vector<Process> processes_;
  Output output_;
  Clock now_ns_;
  bus::Subscriber heartbeats_;

  mutable std::mutex mutex_;
  std::vector<ProcessStatus> published_;
  std::optional<std::string> failure_;
};

}  // namespace splatbus::cli
