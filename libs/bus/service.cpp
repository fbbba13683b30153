#include "bus/service.h"

#include <fmt/format.h>
#include <pthread.h>
#include <signal.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <exception>
#include <utility>

#include "bus/connection_guard.h"
#include "bus/error.h"
#include "bus/heartbeat_thread.h"
#include "bus/log_sink.h"

namespace splatbus::bus {
namespace {

struct Flags {
  std::string address, key, server_key;
  std::string name;
  std::string log_level = "info";
  std::string backend = "auto";
  std::vector<std::string> changes;
  bool list_parameters = false;
};

void add_flags(CLI::App& app, Flags& flags) {
  app.add_option("--bus", flags.address, "ipc:///directory or tcp://host:port of the bus")->envname("SPLATBUS_BUS");
  app.add_option("--key", flags.key, "key file, for a bus over tcp (made by 'splatbus keys'); else SPLATBUS_KEY");
  app.add_option("--server-key", flags.server_key, "public key of that bus; else SPLATBUS_SERVER_KEY");
  app.add_option("--name", flags.name, "name on the bus, unique there")->capture_default_str();
  app.add_option("--set", flags.changes, "name=value of a parameter; repeatable")->allow_extra_args(false);
  app.add_option("--backend", flags.backend, "where it computes: cpu, cuda or auto")
      ->envname("SPLATBUS_BACKEND")
      ->check(CLI::IsMember({"cpu", "cuda", "auto"}))
      ->capture_default_str();
  app.add_option("--log-level", flags.log_level, "trace, debug, info, warn, error or off")->capture_default_str();
  app.add_flag("--parameters", flags.list_parameters, "print the parameters with their defaults, and exit");
}

std::string describe_range(const ParameterSpec& spec) {
  if (!spec.choices.empty()) return fmt::format(" One of: {}.", fmt::join(spec.choices, ", "));
  const bool number =
      std::holds_alternative<double>(spec.default_value) || std::holds_alternative<std::int64_t>(spec.default_value);
  const auto bounded = [](double bound) { return std::abs(bound) < 1e18; };
  const auto [minimum, maximum] = spec.range;
  if (!number || (!bounded(minimum) && !bounded(maximum))) return {};
  if (!bounded(maximum)) return fmt::format(" At least {}.", minimum);
  if (!bounded(minimum)) return fmt::format(" At most {}.", maximum);
  return fmt::format(" From {} to {}.", minimum, maximum);
}

void print_parameters(const Parameters& parameters) {
  const auto values = parameters.list();
  for (std::size_t i = 0; i < values.size(); ++i) {
    const auto& spec = parameters.specs()[i];
    fmt::print("{} = {}\n    {}{}{}\n", values[i].first, values[i].second, spec.description, describe_range(spec),
               spec.change == kRuntime ? "" : " Fixed at start.");
  }
}

void set_parameters(Parameters& parameters, const std::vector<std::string>& changes) {
  for (const auto& change : changes) {
    const auto equals = change.find('=');
    if (equals == std::string::npos) throw Error(fmt::format("--set '{}': expected name=value", change));
    const auto problem = parameters.set(change.substr(0, equals), change.substr(equals + 1), false);
    if (!problem.empty()) throw Error("--set: " + problem);
  }
}

int run_service(const Flags& flags, const ServiceDescription& description, Parameters& parameters,
                const std::function<void(ServiceContext&)>& run) {
  std::stop_source stop;
  const StopSignals signals(stop);
  const Device backend = choose_backend(flags.backend);
  raise_descriptor_limit();
  auto address = flags.address.empty() ? Address::from_environment() : Address::parse(flags.address);
  address.key_file = flags.key;
  address.server_key = flags.server_key;
  const auto context = Context::create(address, flags.name);
  install_logger(context, flags.log_level);
  ServiceContext service(context, parameters, stop.get_token(), backend);
  std::string failure;
  {
    HeartbeatThread heartbeats(service, description.kind);
    spdlog::info("{} on {}, backend {}", description.kind, address.text(), name_of(backend));
    try {
      run(service);
    } catch (const std::exception& error) {
      failure = error.what();
      spdlog::critical("{}", failure);
    }
    heartbeats.finish(failure.empty() ? wire::ServiceState::Stopping : wire::ServiceState::Failed, failure);
  }
  uninstall_logger();
  return failure.empty() ? 0 : 1;
}

}  // namespace

int service_main(int argc, char** argv, const ServiceDescription& description,
                 const std::function<void(ServiceContext&)>& run) {
  CLI::App app(description.summary, "splatbus-" + description.kind);
  Flags flags;
  flags.name = description.kind;
  add_flags(app, flags);
  CLI11_PARSE(app, argc, argv);
  Parameters parameters(description.parameters);
  try {
    set_parameters(parameters, flags.changes);
    if (flags.list_parameters) {
      print_parameters(parameters);
      return 0;
    }
    return run_service(flags, description, parameters, run);
  } catch (const std::exception& error) {
    fmt::print(stderr, "splatbus-{}: {}\n", description.kind, error.what());
    return 1;
  }
}

StopSignals::StopSignals(std::stop_source& source) {
  sigset_t signals;
  ::sigemptyset(&signals);
  ::sigaddset(&signals, SIGINT);
  ::sigaddset(&signals, SIGTERM);
  ::pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  thread_ = std::jthread([signals, &source](const std::stop_token& end) {
    const timespec wait{0, 100'000'000};  // how soon `end` is seen; a signal is seen at once
    while (!end.stop_requested()) {
      if (::sigtimedwait(&signals, nullptr, &wait) < 0) continue;
      if (source.stop_requested()) ::_exit(130);
      source.request_stop();
    }
  });
}

}  // namespace splatbus::bus
