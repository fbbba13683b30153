#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "bus/clock.h"
#include "bus/file_descriptor.h"
#include "bus/subscriber.h"
#include "child_process.h"
#include "launch_plan.h"
#include "probe_runner.h"
#include "process_output.h"

namespace splatbus::cli {

/// Ended: by itself, with success. Stopped: an operator asked for it.
enum class ProcessState { Waiting, Starting, Running, BackOff, Stopping, Stopped, Ended, Failed };

[[nodiscard]] const char* to_string(ProcessState state);

/// Last lines of a process's output that are kept, to be told when it fails.
inline constexpr std::size_t kLinesKept = 12;

/// A second process of an entry: its successor, which gets ready beside it, or, after the exchange, its predecessor.
struct BesideStatus {
  pid_t pid = 0;  ///< 0 when it has ended
  bool successor = true;
  std::string service_state;               ///< of its last heartbeat, as the schema names it; empty before the first
  std::string detail;                      ///< what its last heartbeat says
  std::map<std::string, double> counters;  ///< of its last heartbeat
  std::optional<ExitStatus> exit;          ///< once it has ended
  std::vector<std::string> last_lines;     ///< of its output
};

struct ProcessStatus {
  std::string name;
  std::string service;  ///< entry of the launch file, whose replica this is
  int replica = 1;
  ProcessState state = ProcessState::Waiting;
  pid_t pid = 0;  ///< 0 when it does not run
  int restarts = 0;
  std::int64_t started_ns = 0;             ///< by the supervisor's clock; 0 when it does not run
  std::string detail;                      ///< why it waits or failed, or what its heartbeat says
  std::map<std::string, double> counters;  ///< of its last heartbeat
  std::optional<BesideStatus> beside;
};

/// Seconds until a process is started again that ended `attempts` times in a row, at least once.
[[nodiscard]] double back_off_s(int attempts, double first_s = 0.1, double max_s = 8);

/// Runs a launch plan: starts each process when those before it are ready (first heartbeat with state Running), passes
/// its output on, and starts it again with back-off when it ends, when it sends no heartbeat any more, or never became
/// ready. A bus that is away stops nobody: heartbeats are only missed while the broker's own arrive.
class Supervisor {
 public:
  /// CLOCK_MONOTONIC nanoseconds, or what a test takes for them.
  using Clock = std::function<std::int64_t()>;

  Supervisor(LaunchPlan plan, Output output, Clock now_ns = bus::now_ns);
  ~Supervisor();  ///< kills what still runs
  Supervisor(const Supervisor&) = delete;
  Supervisor& operator=(const Supervisor&) = delete;

  /// Until `stop` is asked for, or nothing is left to run or to be started again. Then stops every process after those
  /// that depend on it: SIGTERM, and SIGKILL to what does not go, at once when `kill` is asked for. False when, at the
  /// end, anything was not running that should have been. Processes die with the thread that calls this.
  bool run(const std::stop_token& stop, const std::stop_token& kill);

  /// Any thread.
  [[nodiscard]] std::vector<ProcessStatus> status() const;
  /// The first process that failed for good, and why. Any thread.
  [[nodiscard]] std::optional<std::string> failure() const;
  /// After run(): what was not running at its end, and why.
  [[nodiscard]] std::vector<std::string> not_running() const;

  using Condition = std::function<bool(const std::vector<ProcessStatus>&)>;
  /// Until the condition holds of status(); false when it does not within the time, `stop` is asked for, or run() is
  /// over. Any thread but run()'s.
  bool wait_until(const Condition& condition, std::chrono::duration<double> timeout,
                  const std::stop_token& stop = {}) const;

  // Orders of an operator: any thread but run()'s, while that runs. status() shows them at work when they return. They
  // throw std::runtime_error when there is no such process, when it is in no state for it (a successor gets ready
  // beside it), or run() is over.
  void start(const std::string& name);    ///< nothing when it runs already
  void stop(const std::string& name);     ///< SIGTERM, later SIGKILL; stays stopped
  void restart(const std::string& name);  ///< forgets earlier ends; starts what does not run
  /// One more process, which starts after those named; one that is not there (any more) is not waited for. The plan's
  /// own `after` counts for nothing: it has indices of a plan that is not known here.
  void add(ProcessPlan plan, std::vector<std::string> after);
  void remove(const std::string& name);                        ///< stops it, and forgets it when it has ended
  [[nodiscard]] ProcessPlan plan_of(const std::string& name);  ///< that it runs by, or would
  /// Of the plan that it is started by the next time.
  void change_plan(const std::string& name, const std::function<void(ProcessPlan&)>& change);

  // For a successor that takes over without a gap. A process has one other beside it at most.
  /// Starts `plan` beside process `name`: it sends heartbeats as "name.next", which status() shows as `beside`. What
  /// it does decides nothing here: whoever asked for it watches, and exchanges or drops it.
  void start_successor(const std::string& name, ProcessPlan plan);
  /// The process beside becomes the entry's own, with its plan, and is looked after from now on under either source.
  /// The other one may end by itself; SIGTERM after `leave_within_s`. Exchanges back where it is called again before
  /// that.
  void exchange(const std::string& name, double leave_within_s);
  /// Stops and forgets the process beside; nothing when there is none. An entry that ended beside its successor is
  /// started again as its policy says: until then it waits for what becomes of that.
  void drop_beside(const std::string& name);

 private:
  /// A process from its start to its end.
  struct Life {
    ProcessPlan plan;
    std::optional<ChildProcess> child;
    std::int64_t started_ns = 0;
    std::int64_t ready_ns = 0;
    std::int64_t last_sign_ns = 0;  ///< last heartbeat, or the broker's return
    std::int64_t terminate_ns = 0;  ///< when SIGTERM or SIGKILL was sent, 0 before
    std::unique_ptr<ProbeRunner> readiness, liveness;
    void stop_probes() { readiness.reset(), liveness.reset(); }
    std::string service_state, detail;
    std::string last_line;  ///< of its output that may say why it ended
    std::map<std::string, double> counters;
  };
  struct Beside {
    std::unique_ptr<Life> life = std::make_unique<Life>();
    bool successor = true;
    std::int64_t leave_by_ns = 0;  ///< SIGTERM then; 0: not asked to leave
    bool forget = false;           ///< when it has ended
    std::optional<ExitStatus> exit;
    std::vector<std::string> last_lines;
  };
  enum class AtEnd { Policy, StartAgain, StayStopped, Forget };
  struct Process {
    std::string name;
    std::vector<std::string> after;
    std::unique_ptr<Life> life = std::make_unique<Life>();
    std::unique_ptr<Beside> beside;
    ProcessState state = ProcessState::Waiting;
    int restarts = 0;
    AtEnd at_end = AtEnd::Policy;
    std::int64_t next_start_ns = 0;  ///< when in BackOff
    int attempts = 0;                ///< ends in a row without a healthy while between them
    bool was_ready = false;          ///< in any life: what waits for it may go
    bool gone = false;               ///< to be forgotten
    std::optional<ExitStatus> held;  ///< how it ended while a successor stands by; what follows waits for that
    /// A successor is there that may yet take its place.
    [[nodiscard]] bool is_swapped() const { return beside && beside->successor && !beside->forget; }
  };

  // supervisor.cpp
  void wait_for_events();
  void pass_output(Process& process, bool rest);
  void pass_beside_output(Process& process, bool rest);
  void take(const wire::Heartbeat& heartbeat, std::string_view source);
  [[nodiscard]] std::pair<Process*, Life*> sender(std::string_view source, pid_t pid);
  void terminate_in_order(bool kill);
  [[nodiscard]] bool anything_to_do() const;
  void note_what_does_not_run();
  void say(const Process& process, const std::string& event, const std::string& text, pid_t pid = 0,
           std::optional<ExitStatus> exit = {}, std::optional<double> restart_in_s = {}) const;
  void publish_status();

  // supervisor_life.cpp
  void reap(Process& process, bool stopping);
  void ended(Process& process, const ExitStatus& status);
  void ended_on_order(Process& process);
  void start_what_is_due();
  void spawn(Process& process);
  /// Where it cannot be, StartedTooSoon or std::runtime_error.
  void start_child(Life& life);
  /// With back-off; fails it after too many attempts in a row.
  void start_later(Process& process, const std::string& reason, std::optional<ExitStatus> exit = {});
  void ready(Process& process);
  void check_signs_of_life();
  void check_probes();
  void kill(Life& life, const Process& process, const std::string& why);
  void kill_what_does_not_stop();
  /// The time up to which silence means something: the broker's own last heartbeat, 0 while it is away.
  [[nodiscard]] std::int64_t bus_heard_until() const;
  void fail(Process& process, const std::string& reason, std::optional<ExitStatus> exit = {});

  // supervisor_orders.cpp
  void order(std::function<void()> work);
  void obey_orders();
  void refuse_orders();
  [[nodiscard]] Process& find(const std::string& name);
  [[nodiscard]] Process& find_not_swapped(const std::string& name);
  void stop_for(Process& process, AtEnd at_end);
  void forget_failure(const Process& process);
  void reap_beside(Process& process);

  std::list<Process> processes_;
  Output output_;
  Clock now_ns_;
  bus::Subscriber heartbeats_;
  bus::FileDescriptor wake_;  ///< an eventfd: there are orders

  mutable std::mutex mutex_;
  mutable std::condition_variable_any changed_;
  std::vector<ProcessStatus> published_;
  std::vector<std::pair<std::string, std::string>> failures_;  ///< process and reason
  std::vector<std::string> not_running_;
  std::vector<std::function<void()>> orders_;
  bool over_ = false;
};

}  // namespace splatbus::cli
