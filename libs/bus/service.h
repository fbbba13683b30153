#pragma once

#include <atomic>
#include <condition_variable>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <stop_token>
#include <string>
#include <thread>
#include <vector>

#include "bus/backend.h"
#include "bus/context.h"
#include "bus/parameters.h"
#include "bus/shorthand.h"

namespace splatbus::bus {

/// What a running service has in hand.
class ServiceContext {
 public:
  std::shared_ptr<Context> bus;  ///< of a successor that stands by: "<name>.next", to read with
  Parameters& parameters;
  std::stop_token stop;  ///< SIGINT, SIGTERM, and Order::Yield
  Device backend = Device::Cpu;

  /// Shown in the next heartbeat; any thread.
  void counter(const std::string& name, double value);
  void detail(const std::string& text);  ///< what it waits for, in words

  /// Whether this process is a successor that has not taken over yet.
  [[nodiscard]] bool stands_by() const { return stands_by_; }
  /// Of a successor, whose heartbeats say Starting until then: Standby from now on, for all that it needs is here; or,
  /// after take_over(), Running, for it has gone on where the one before has ended. Of who opens ports: Running.
  void ready() { ready_ = true; }
  /// Of a successor: ready(), then calls `turn` again and again (where there is none, sleeps) until it is told to take
  /// over and the one before has let go of its name. `bus` is then another context, of that name: whatever publishes
  /// or has slabs is made after this; subscribers of before go on. False when a stop is asked for instead. True at
  /// once for who is no successor, or has taken over. Throws Error when the other one does not let go.
  [[nodiscard]] bool take_over(const std::function<void()>& turn = {});
  /// The stop is a handover: a successor is ready, and goes on with what is left for it.
  [[nodiscard]] bool yields() const { return yields_; }

  ServiceContext(std::shared_ptr<Context> bus, Parameters& parameters, std::stop_token stop,
                 Device backend = Device::Cpu);

 private:
  friend class HeartbeatThread;
  friend class ServiceProcess;
  std::mutex mutex_;
  std::map<std::string, double> counters_;
  std::string detail_;
  std::atomic<bool> stands_by_{false}, ready_{true}, told_to_take_over_{false}, yields_{false};
  std::condition_variable_any told_;  ///< of told_to_take_over_, with mutex_
  std::function<void()> change_name_;
  std::function<void()> request_stop_;
};

/// What a successor of that name calls itself while it stands by.
[[nodiscard]] std::string successor_name(const std::string& name);

/// A flag that a program's own main takes before service_main() sees it, for --help.
struct OwnFlag {
  std::string flag, value, help;  ///< "--replay", "FILE"
};

struct ServiceDescription {
  std::string kind;     ///< "trainer"
  std::string summary;  ///< one line for --help
  std::vector<ParameterSpec> parameters;
  std::vector<Shorthand> shorthands{};
  std::vector<OwnFlag> own_flags{};
  /// Throws Error when parameters that are good each for itself do not go together.
  std::function<void(const Parameters&)> check{};
  /// `run` calls ServiceContext::take_over() itself, so that a successor can get ready beside the one before. Of all
  /// others service_main calls it first.
  bool stands_by = false;
  /// `run` calls ready() once its ports are open; heartbeats say Starting until then.
  bool opens_ports = false;
};

/// The main of every service but the broker. Flags: --bus ADDRESS, --name SOURCE (default: kind), --backend
/// cpu, cuda or auto (default: SPLATBUS_BACKEND, or auto), --set name=value (repeatable), --log-level, --parameters
/// (print them with defaults and units, and exit; with --json one line, parse_parameter_report()). Sets up spdlog (to
/// stderr and sys/log), signals, heartbeats 5 times a second, and control/<kind> and control/<source>, then calls `run`
/// and returns its exit status: 0 after a stop was asked for (under a supervisor 128 + the signal, where it was one), 1
/// with a logged reason when `run` throws, 78 when what it throws is a PermanentError, 2 when flags or parameters are
/// wrong. With --successor it stands by, as "<name>.next", until it is told to take over (docs/swap.md).
int service_main(int argc, char** argv, const ServiceDescription& description,
                 const std::function<void(ServiceContext&)>& run);

/// Turns SIGINT and SIGTERM into a stop request; a second one ends the process at once with status 130. Make it before
/// any other thread: it blocks the signals in the calling thread, and threads inherit that.
class StopSignals {
 public:
  explicit StopSignals(std::stop_source& source);

  /// exit_status_after() the signal that came, if any.
  [[nodiscard]] int exit_status() const;

 private:
  std::atomic<int> signal_ = 0;
  std::jthread thread_;
};

}  // namespace splatbus::bus
