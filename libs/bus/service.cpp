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
#include <optional>
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
  bool successor = false;
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
  app.add_flag("--successor", flags.successor, "stand by, and take the place of the one of that name when told to");
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

}  // namespace

/// What service_main has beside the service's own threads.
class ServiceProcess {
 public:
  ServiceProcess(const Flags& flags, const ServiceDescription& description, Parameters& parameters)
      : flags_(flags),
        description_(description),
        signals_(stop_),
        backend_(choose_backend(flags.backend)),
        address_(flags.address.empty() ? Address::from_environment() : Address::parse(flags.address)) {
    raise_descriptor_limit();
    address_.key_file = flags.key;
    address_.server_key = flags.server_key;
    service_.emplace(connect(flags.successor ? successor_name(flags.name) : flags.name), parameters, stop_.get_token(),
                     backend_);
    service_->stands_by_ = flags.successor;
    service_->ready_ = !flags.successor;
    service_->request_stop_ = [this] { stop_.request_stop(); };
    service_->change_name_ = [this] { change_name(); };
  }

  int run(const std::function<void(ServiceContext&)>& run) {
    std::string failure;
    heartbeats_.emplace(*service_, description_.kind);
    spdlog::info("{} on {}, backend {}{}", description_.kind, address_.text(), name_of(backend_),
                 flags_.successor ? ", stands by" : "");
    try {
      if (!flags_.successor) claim_own_name();
      if (description_.stands_by || service_->take_over()) run(*service_);
    } catch (const std::exception& error) {
      failure = error.what();
      spdlog::critical("{}", failure);
    }
    heartbeats_->finish(failure.empty() ? wire::ServiceState::Stopping : wire::ServiceState::Failed, failure);
    heartbeats_.reset();
    uninstall_logger();
    return failure.empty() ? 0 : 1;
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
    service_->bus = std::move(context);
    service_->stands_by_ = false;
    service_->ready_ = !description_.stands_by;
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
  add_flags(app, flags);
  CLI11_PARSE(app, argc, argv);
  Parameters parameters(description.parameters);
  try {
    set_parameters(parameters, flags.changes);
    if (flags.list_parameters) {
      print_parameters(parameters);
      return 0;
    }
    return ServiceProcess(flags, description, parameters).run(run);
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
