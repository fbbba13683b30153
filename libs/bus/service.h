#pragma once

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

namespace splatbus::bus {

/// What a running service has in hand.
class ServiceContext {
 public:
  std::shared_ptr<Context> bus;
  Parameters& parameters;
  std::stop_token stop;  ///< SIGINT, SIGTERM
  Device backend = Device::Cpu;

  /// Shown in the next heartbeat; any thread.
  void counter(const std::string& name, double value);
  void detail(const std::string& text);  ///< what it waits for, in words

  ServiceContext(std::shared_ptr<Context> bus, Parameters& parameters, std::stop_token stop,
                 Device backend = Device::Cpu);

 private:
  friend class HeartbeatThread;
  std::mutex mutex_;
  std::map<std::string, double> counters_;
  std::string detail_;
};

struct ServiceDescription {
  std::string kind;     ///< "trainer"
  std::string summary;  ///< one line for --help
  std::vector<ParameterSpec> parameters;
  /// Throws Error when parameters that are good each for itself do not go together.
  std::function<void(const Parameters&)> check{};
};

/// The main of every service but the broker. Flags: --bus ADDRESS, --name SOURCE (default: kind), --backend
/// cpu, cuda or auto (default: SPLATBUS_BACKEND, or auto), --set name=value (repeatable), --log-level, --parameters
/// (print them with defaults and units, and exit; with --json one line, parse_parameter_report()). Sets up spdlog (to
/// stderr and sys/log), signals, heartbeats 5 times a second, and control/<kind> and control/<source>, then calls `run`
/// and returns its exit status: 0 after a stop was asked for, 1 with a logged reason when `run` throws, 2 when flags or
/// parameters are wrong.
int service_main(int argc, char** argv, const ServiceDescription& description,
                 const std::function<void(ServiceContext&)>& run);

/// Turns SIGINT and SIGTERM into a stop request; a second one ends the process at once with status 130. Make it before
/// any other thread: it blocks the signals in the calling thread, and threads inherit that.
class StopSignals {
 public:
  explicit StopSignals(std::stop_source& source);

 private:
  std::jthread thread_;
};

}  // namespace splatbus::bus
