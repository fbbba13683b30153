#include "bus/service.h"

#include <fmt/format.h>
#include <pthread.h>
#include <signal.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>
#include <optional>
#include <utility>

#include "bus/command_line.h"
#include "bus/connection_guard.h"
#include "bus/error.h"
#include "bus/heartbeat_thread.h"
#include "bus/log_sink.h"
#include "bus/parameter_json.h"
#include "bus/permanent_error.h"

namespace splatbus::bus {
namespace {

struct Flags {
  std::string address, key, server_key;
  std::string name;
  std::string log_level = "info";
  std::string backend = "auto";
  std::vector<std::string> changes, shorthands;
  bool list_parameters = false;
  bool json = false;
  bool successor = false;
};

void add_flags(CLI::App& app, Flags& flags, const ServiceDescription& description) {
  app.add_option("--bus", flags.address, "bus address, ipc:///folder or tcp://host:port")->envname("SPLATBUS_BUS");
  app.add_option("--key", flags.key, "key file for a bus over tcp, made by 'splatbus keys' (default: SPLATBUS_KEY)");
  app.add_option("--server-key", flags.server_key, "public key of that bus (default: SPLATBUS_SERVER_KEY)");
  app.add_option("--name", flags.name, "name on the bus, unique there")->capture_default_str();
  app.add_option("--set", flags.changes, "set a parameter, name=value (repeatable)")->allow_extra_args(false);
  add_backend_and_shorthands(app, description.shorthands, flags.backend, flags.shorthands);
  app.add_option("--log-level", flags.log_level, "trace, debug, info, warn, error or off")
      ->check(CLI::IsMember({"trace", "debug", "info", "warn", "error", "off"}))
      ->capture_default_str();
  app.add_flag("--successor", flags.successor, "stand by, and take the place of the one of that name when told to");
  app.add_flag("--parameters", flags.list_parameters, "check and print the parameters, and exit");
  app.add_flag("--json", flags.json, "with --parameters: print them as one line of JSON");
  for (const OwnFlag& own : description.own_flags) app.add_option(own.flag, own.help)->type_name(own.value);
}

void print_parameters(const Parameters& parameters) {
  for (const ParameterDescription& p : describe(parameters)) {
    const std::string bounds = p.bounds.empty() ? "" : ", " + p.bounds;
    fmt::print("{} = {}\n    {} ({}{}{})\n", p.name, p.value, p.text, p.type, bounds,
               p.at_start ? ", fixed at start" : "");
  }
}

/// Applies every --set, and returns what is wrong with those that cannot be, or with all of them together.
std::vector<ParameterProblem> set_parameters(Parameters& parameters, const std::vector<std::string>& changes,
                                             const ServiceDescription& description) {
  std::vector<ParameterProblem> problems;
  for (const auto& change : changes) {
    const auto equals = change.find('=');
    const std::string name = change.substr(0, equals);
    const std::string problem = equals == std::string::npos ? fmt::format("'{}': expected name=value", change)
                                                            : parameters.set(name, change.substr(equals + 1), false);
    if (!problem.empty()) problems.push_back({name, problem});
  }
  if (!problems.empty() || !description.check) return problems;
  try {
    description.check(parameters);
  } catch (const std::exception& error) {
    problems.push_back({"", error.what()});
  }
  return problems;
}

}  // namespace

/// What service_main has beside the service's own threads.
class ServiceProcess {
 public:
  ServiceProcess(const Flags& flags, Address address, const ServiceDescription& description, Parameters& parameters)
      : flags_(flags),
        description_(description),
        signals_(stop_),
        backend_(choose_backend(flags.backend)),
        address_(std::move(address)) {
    raise_descriptor_limit();
    address_.key_file = flags.key;
    address_.server_key = flags.server_key;
    service_.emplace(connect(flags.successor ? successor_name(flags.name) : flags.name), parameters, stop_.get_token(),
                     backend_);
    service_->stands_by_ = flags.successor;
    service_->ready_ = !flags.successor && !description.opens_ports;
    service_->request_stop_ = [this] { stop_.request_stop(); };
    service_->change_name_ = [this] { change_name(); };
  }

  int run(const std::function<void(ServiceContext&)>& run) {
    std::string failure;
    int status = kExitFailed;
    heartbeats_.emplace(*service_, description_.kind);
    spdlog::info("{} on {}, backend {}{}", description_.kind, address_.text(), name_of(backend_),
                 flags_.successor ? ", stands by" : "");
    try {
      if (!flags_.successor) claim_own_name();
      if (description_.stands_by || service_->take_over()) run(*service_);
    } catch (const PermanentError& error) {
      failure = error.what();
      status = kExitPermanent;
    } catch (const std::exception& error) {
      failure = error.what();
    }
    if (!failure.empty()) spdlog::critical("{}", failure);
    heartbeats_->finish(failure.empty() ? wire::ServiceState::Stopping : wire::ServiceState::Failed, failure);
    heartbeats_.reset();
    uninstall_logger();
    return failure.empty() ? signals_.exit_status() : status;
  }

 private:
  std::shared_ptr<Context> connect(const std::string& name) {
    auto context = Context::create(address_, name);
    install_logger(context, flags_.log_level);
    return context;
  }

  /// So that a successor knows when it is free.
  void claim_own_name() {
    try {
      service_->bus->claim(std::chrono::milliseconds(0));
    } catch (const Error& error) {
      spdlog::warn("{}", error.what());  // what it publishes is refused by the broker; slabs, by the registry
    }
  }

  void change_name() {
    auto context = Context::create(address_, flags_.name);
    context->claim(kNamePatience);
    heartbeats_->finish(wire::ServiceState::Stopping, "takes over");
    heartbeats_.reset();
    install_logger(context, flags_.log_level);
    // Subscribers of before keep it, and the next successor is to have its name.
    service_->bus->fall_silent();
    service_->bus = std::move(context);
    service_->stands_by_ = false;
    service_->ready_ = !description_.stands_by && !description_.opens_ports;
    heartbeats_.emplace(*service_, description_.kind);
    spdlog::info("took over as process {}", ::getpid());
  }

  static constexpr std::chrono::seconds kNamePatience{20};
  const Flags& flags_;
  const ServiceDescription& description_;
  std::stop_source stop_;
  const StopSignals signals_;
  const Device backend_;
  Address address_;
  std::optional<ServiceContext> service_;
  std::optional<HeartbeatThread> heartbeats_;
};

int service_main(int argc, char** argv, const ServiceDescription& description,
                 const std::function<void(ServiceContext&)>& run) {
  CLI::App app(description.summary, "splatbus-" + description.kind);
  Flags flags;
  flags.name = description.kind;
  add_flags(app, flags, description);
  if (const auto status = parse_command_line(app, argc, argv)) return *status;
  // What --set says of the same parameter is said of it alone, and holds.
  flags.changes.insert(flags.changes.begin(), flags.shorthands.begin(), flags.shorthands.end());
  Parameters parameters(description.parameters);
  const auto problems = set_parameters(parameters, flags.changes, description);
  if (flags.list_parameters && flags.json) {
    fmt::print("{}\n", to_json({describe(parameters), problems}));
    return problems.empty() ? 0 : kExitUsage;
  }
  for (const auto& problem : problems) fmt::print(stderr, "splatbus-{}: {}\n", description.kind, problem.text);
  if (!problems.empty()) return kExitUsage;
  if (flags.list_parameters) {
    print_parameters(parameters);
    return 0;
  }
  log_to_stderr(flags.name, flags.log_level);
  Address address;
  try {
    address = flags.address.empty() ? Address::from_environment() : Address::parse(flags.address);
  } catch (const Error& error) {
    fmt::print(stderr, "splatbus-{}: {}\n", description.kind, error.what());
    return kExitUsage;
  }
  try {
    return ServiceProcess(flags, std::move(address), description, parameters).run(run);
  } catch (const PermanentError& error) {
    fmt::print(stderr, "splatbus-{}: {}\n", description.kind, error.what());
    return kExitPermanent;
  } catch (const std::exception& error) {
    fmt::print(stderr, "splatbus-{}: {}\n", description.kind, error.what());
    return kExitFailed;
  }
}

StopSignals::StopSignals(std::stop_source& source) {
  sigset_t signals;
  ::sigemptyset(&signals);
  ::sigaddset(&signals, SIGINT);
  ::sigaddset(&signals, SIGTERM);
  ::pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  thread_ = std::jthread([this, signals, &source](const std::stop_token& end) {
    const timespec wait{0, 100'000'000};  // how soon `end` is seen; a signal is seen at once
    while (!end.stop_requested()) {
      const int signal = ::sigtimedwait(&signals, nullptr, &wait);
      if (signal < 0) continue;
      if (signal_ != 0 || source.stop_requested()) ::_exit(128 + signal);
      signal_ = signal;
      source.request_stop();
    }
  });
}

int StopSignals::exit_status() const {
  return exit_status_after(signal_);
}

}  // namespace splatbus::bus
