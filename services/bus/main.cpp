#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <stop_token>
#include <string>
#include <thread>

#include "bus/broker.h"
#include "bus/command_line.h"
#include "bus/connection_guard.h"
#include "bus/error.h"
#include "bus/log_sink.h"
#include "bus/parameter_json.h"
#include "bus/permanent_error.h"
#include "bus/service.h"

namespace {

using splatbus::bus::Address;

splatbus::bus_service::BrokerOptions broker_options(const std::string& address, const std::string& tcp,
                                                    const splatbus::bus::ServerKeyFiles& keys) {
  splatbus::bus_service::BrokerOptions options;
  options.address = address.empty() ? Address::from_environment() : Address::parse(address);
  if (!options.address.is_local()) throw splatbus::bus::Error("--bus: a broker's own bus is ipc:///folder; see --tcp");
  if (!tcp.empty()) {
    const auto remote = Address::parse("tcp://" + tcp);
    options.tcp_host = remote.host;
    options.tcp_port = remote.port;
  }
  options.keys = keys;
  return options;
}

/// One that ends just now, as after a supervisor's death, is waited for.
void start(splatbus::bus_service::Broker& broker, const std::stop_source& stop) {
  constexpr std::chrono::seconds patience(3);
  const auto begun = std::chrono::steady_clock::now();
  while (true) {
    try {
      return broker.start();
    } catch (const splatbus::bus::PermanentError&) {
      if (stop.stop_requested() || std::chrono::steady_clock::now() - begun > patience) throw;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }
}

int run(const splatbus::bus_service::BrokerOptions& options, const std::string& tcp, const std::string& log_level) {
  std::stop_source stop;
  const splatbus::bus::StopSignals signals(stop);
  splatbus::bus::log_to_stderr("bus", log_level);

  splatbus::bus::raise_descriptor_limit();
  splatbus::bus_service::Broker broker(options);
  start(broker, stop);
  spdlog::info("bus on {}{}", options.address.text(), tcp.empty() ? "" : " and tcp://" + tcp);

  std::mutex mutex;
  std::condition_variable_any stopped;
  std::unique_lock lock(mutex);
  while (!stop.stop_requested()) {
    stopped.wait_for(lock, stop.get_token(), std::chrono::seconds(1), [] { return false; });
    if (!broker.intact()) throw splatbus::bus::Error("the bus's folder was removed: " + options.address.text());
  }
  broker.stop();
  return signals.exit_status();
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("The broker: relays messages, keeps latched ones, registers slabs", "splatbus-bus");
  std::string address;
  std::string tcp;
  std::string log_level = "info";
  splatbus::bus::ServerKeyFiles keys;
  bool only_check = false, json = false;
  app.add_option("--bus", address, "bus address, ipc:///folder")->envname("SPLATBUS_BUS");
  app.add_option("--tcp", tcp, "host:port to listen on for other machines; the next port is used too");
  app.add_option("--key", keys.key, "key file of the bus for tcp (default: server.key of 'splatbus keys')");
  app.add_option("--allowed", keys.allowed, "file that lists who may connect (default: that of 'splatbus keys')");
  app.add_flag("--keys-on-loopback", keys.always, "require keys on the loopback address too");
  app.add_option("--log-level", log_level, "trace, debug, info, warn, error or off")
      ->check(CLI::IsMember({"trace", "debug", "info", "warn", "error", "off"}))
      ->capture_default_str();
  app.add_flag("--parameters", only_check, "check the options and exit; there are no parameters");
  app.add_flag("--json", json, "with --parameters: print a line of JSON");
  if (const auto status = splatbus::bus::parse_command_line(app, argc, argv)) return *status;
  splatbus::bus_service::BrokerOptions options;
  try {
    options = broker_options(address, tcp, keys);
  } catch (const std::exception& error) {
    fmt::print(stderr, "splatbus-bus: {}\n", error.what());
    return splatbus::bus::kExitUsage;
  }
  if (only_check) {
    if (json) fmt::print("{}\n", splatbus::bus::to_json({}));
    return 0;
  }
  try {
    return run(options, tcp, log_level);
  } catch (const splatbus::bus::PermanentError& error) {
    fmt::print(stderr, "splatbus-bus: {}\n", error.what());
    return splatbus::bus::kExitPermanent;
  } catch (const std::exception& error) {
    fmt::print(stderr, "splatbus-bus: {}\n", error.what());
    return splatbus::bus::kExitFailed;
  }
}
