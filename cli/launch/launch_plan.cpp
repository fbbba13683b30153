#include "launch_plan.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <unistd.h>

#include <algorithm>
#include <functional>
#include <optional>
#include <set>
#include <stdexcept>

#include "bus/backend.h"
#include "bus/error.h"
#include "bus/nearest.h"
#include "substitution.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;

constexpr const char* kBrokerProgram = "splatbus-bus";

fs::path find_program(const LaunchService& service, const fs::path& programs) {
  const std::string& name = service.program.value;
  const bool is_path = name.find('/') != std::string::npos;
  fs::path found = programs / name;
  if (is_path)
    found = fs::path(name).is_absolute() ? fs::path(name) : fs::path(service.program.mark.file).parent_path() / name;
  if (fs::is_regular_file(found) && access(found.c_str(), X_OK) == 0) return found;
  if (is_path)
    throw LaunchError(service.program.mark, fmt::format("'{}' is not an executable program", found.string()));
  std::vector<std::string> known;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(programs, error)) {
    const std::string candidate = entry.path().filename();
    if (candidate.starts_with("splatbus-")) known.push_back(candidate);
  }
  std::sort(known.begin(), known.end());
  throw LaunchError(service.program.mark,
                    fmt::format("no program '{}' in {}{}", name, programs.string(), bus::suggestion(name, known)));
}

using Variables = std::map<std::string, std::string>;

/// A setting of the file with what is known of its process only now. What the file says of unknown names was refused
/// where it was read; overrides come here unread.
std::string expand(const std::string& text, const Variables& variables, const SourceMark& mark) {
  try {
    return unescaped(substitute(text, [&](const std::string& name) -> std::optional<std::string> {
      if (const auto found = variables.find(name); found != variables.end()) return escaped(found->second);
      throw LaunchError(mark,
                        fmt::format("unknown variable '${{{}}}'{}", name, bus::suggestion(name, process_variables())));
    }));
  } catch (const std::invalid_argument& error) {
    throw LaunchError(mark, error.what());
  }
}

std::vector<std::string> process_names(const LaunchService& service) {
  if (service.replicas == 1) return {service.name};
  std::vector<std::string> names;
  for (int replica = 1; replica <= service.replicas; ++replica) {
    names.push_back(fmt::format("{}-{}", service.name, replica));
  }
  return names;
}

bool is_broker(const LaunchService& service) {
  return fs::path(service.program.value).filename() == kBrokerProgram;
}

/// What there is one of on a bus, in words, or null: a second one would be refused by the first, or undo its work.
const char* singleton_of(const LaunchService& service) {
  const std::string program = fs::path(service.program.value).filename();
  if (program == kBrokerProgram) return "one broker";
  if (program == "splatbus-trainer") return "one trainer, whose model it is";
  if (program == "splatbus-expander") return "one expander, which knows what it has inserted";
  return nullptr;
}

/// The broker has flags only, and what sends no heartbeat is no service of ours.
bool takes_parameters(const LaunchService& service) {
  return !is_broker(service) && service.heartbeat_timeout_s > 0;
}

/// Services in an order in which each comes after those that it waits for, the broker first, else as in the file.
std::vector<const LaunchService*> ordered(const LaunchFile& file) {
  std::vector<const LaunchService*> order;
  std::set<std::string> placed;
  const std::function<void(const LaunchService&)> place = [&](const LaunchService& service) {
    if (!placed.insert(service.name).second) return;
    for (const auto& dependency : service.after) {
      const auto found = std::find_if(file.services.begin(), file.services.end(),
                                      [&](const LaunchService& s) { return s.name == dependency.value; });
      if (found != file.services.end()) place(*found);
    }
    order.push_back(&service);
  };
  for (const LaunchService& service : file.services) {
    if (is_broker(service)) place(service);
  }
  for (const LaunchService& service : file.services) place(service);
  return order;
}

ProcessPlan make_process(const LaunchService& service, const fs::path& program, const std::string& name, int replica,
                         const LaunchFile& file, const bus::Address& address) {
  const Variables variables{
      {"name", name}, {"replica", std::to_string(replica)}, {"bus_dir", address.directory.value_or("")}};
  ProcessPlan process;
  process.name = name;
  process.service = service.name;
  process.replica = replica;
  process.program = program;
  process.nice = service.nice;
  process.restart = service.restart.policy;
  process.restart_attempts = service.restart.max_attempts;
  process.restart_window_s = service.restart.window_s;
  process.restart_delay_s = service.restart.first_delay_s;
  process.restart_max_delay_s = service.restart.max_delay_s;
  process.heartbeat_timeout_s = service.heartbeat_timeout_s;
  process.start_timeout_s = service.start_timeout_s;
  process.stop_timeout_s = service.stop_timeout_s;
  process.readiness = service.readiness;
  process.liveness = service.liveness;
  process.broker = is_broker(service);
  if (service.heartbeat_timeout_s > 0) process.arguments = {"--bus", address.text()};
  if (takes_parameters(service)) process.arguments.insert(process.arguments.end(), {"--name", name});
  // A verb of the program's, as in `splatbus record`, comes before what it takes.
  const bool verb = !service.args.empty() && !service.args.front().starts_with('-');
  std::size_t place = verb ? 0 : process.arguments.size();
  for (const std::string& argument : service.args) {
    process.arguments.insert(process.arguments.begin() + static_cast<std::ptrdiff_t>(place++),
                             expand(argument, variables, service.mark));
  }
  for (const auto& [key, setting] : service.parameters) {
    process.arguments.emplace_back("--set");
    process.arguments.push_back(fmt::format("{}={}", key, expand(setting.value, variables, setting.mark)));
  }
  process.environment = {{"SPLATBUS_BUS", address.text()},
                         {kLaunchFileVariable, fs::absolute(service.mark.file).lexically_normal().string()},
                         {kLaunchServiceVariable, service.name}};
  // In the environment: a program that knows of no backends does not mind.
  if (const auto& backend = service.backend ? service.backend : file.backend) {
    process.backend = backend->value;
    process.environment["SPLATBUS_BACKEND"] = backend->value;
  }
  for (const auto& [key, value] : service.environment)
    process.environment[key] = expand(value, variables, service.mark);
  return process;
}

}  // namespace

fs::path program_directory() {
  return fs::read_symlink("/proc/self/exe").parent_path();
}

void set_parameter(ProcessPlan& process, const std::string& key, const std::string& value) {
  const std::string assigned = key + "=";
  auto& arguments = process.arguments;
  for (auto at = arguments.begin(); at != arguments.end();) {
    const auto next = std::next(at);
    const bool is_it = *at == "--set" && next != arguments.end() && next->starts_with(assigned);
    at = is_it ? arguments.erase(at, at + 2) : next;
  }
  arguments.insert(arguments.end(), {"--set", assigned + value});
}

LaunchPlan plan_launch(const LaunchFile& file, const bus::Address& bus, const fs::path& programs) {
  LaunchPlan plan{bus, {}};
  std::map<std::string, std::vector<std::size_t>> indices;  // of a service's replicas
  std::vector<std::size_t> brokers;
  std::map<std::string, SourceMark> names;
  std::vector<LaunchProblem> problems;
  const auto place = [&](const LaunchService* service) {
    const fs::path program = find_program(*service, programs);
    if (const char* const one = singleton_of(*service); one != nullptr && service->replicas > 1) {
      throw LaunchError(service->mark, fmt::format("'{}' cannot have {} replicas: a bus has {}", service->name,
                                                   service->replicas, one));
    }
    if (!takes_parameters(*service) && !service->parameters.empty()) {
      throw LaunchError(service->parameters.begin()->second.mark,
                        fmt::format("'{}' takes no parameters: use 'args'", service->name));
    }
    std::set<std::size_t> after(brokers.begin(), brokers.end());
    for (const auto& dependency : service->after) {
      after.insert(indices[dependency.value].begin(), indices[dependency.value].end());
    }
    int replica = 0;
    std::vector<std::size_t> own;
    for (const std::string& name : process_names(*service)) {
      const auto [taken, inserted] = names.emplace(name, service->mark);
      if (!inserted) {
        throw LaunchError(service->mark, fmt::format("process name '{}' is taken, at {}", name, taken->second.text()));
      }
      plan.processes.push_back(make_process(*service, program, name, ++replica, file, bus));
      plan.processes.back().after.assign(after.begin(), after.end());
      own.push_back(plan.processes.size() - 1);
    }
    if (is_broker(*service)) brokers.insert(brokers.end(), own.begin(), own.end());
    indices[service->name] = std::move(own);
  };
  for (const LaunchService* service : ordered(file)) {
    try {
      place(service);
    } catch (const LaunchError& error) {
      problems.insert(problems.end(), error.problems().begin(), error.problems().end());
    }
  }
  if (!problems.empty()) throw LaunchError(std::move(problems));
  return plan;
}

std::vector<std::string> heartbeat_sources(const LaunchFile& file) {
  std::vector<std::string> sources;
  for (const LaunchService& service : file.services) {
    if (is_broker(service) || service.heartbeat_timeout_s <= 0) continue;
    for (std::string& name : process_names(service)) sources.push_back(std::move(name));
  }
  return sources;
}

void check_backends(const LaunchFile& file) {
  const auto check = [](const std::optional<Marked<std::string>>& backend) {
    if (!backend || backend->value != "cuda") return;
    try {
      static_cast<void>(bus::choose_backend(backend->value));
    } catch (const bus::Error& error) {
      throw LaunchError(backend->mark, error.what());
    }
  };
  check(file.backend);
  for (const LaunchService& service : file.services) check(service.backend);
}

std::filesystem::path default_launch_file(const std::string& name) {
  namespace fs = std::filesystem;
  fs::path relative = fs::path("launch") / name;
  if (fs::exists(relative)) return relative;
  const fs::path programs = program_directory();
  for (fs::path folder = programs; folder.has_relative_path(); folder = folder.parent_path()) {
    if (fs::exists(folder / relative)) return folder / relative;
    if (fs::exists(folder / "share/splatbus" / relative)) return folder / "share/splatbus" / relative;  // installed
  }
  throw std::runtime_error(relative.string() + " is neither here nor above " + programs.string() + "; give --launch");
}

}  // namespace splatbus::cli
