#include "launch_plan.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <functional>
#include <optional>
#include <set>
#include <stdexcept>

#include "bus/backend.h"
#include "bus/error.h"
#include "child_process.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;

constexpr const char* kBrokerProgram = "splatbus-bus";

std::string joined(const std::set<std::string>& names) {
  return fmt::format("{}", fmt::join(names, ", "));
}

fs::path find_program(const LaunchService& service, const LaunchFile& file, const fs::path& programs) {
  const std::string& name = service.program.value;
  const bool is_path = name.find('/') != std::string::npos;
  fs::path found = programs / name;
  if (is_path) found = fs::path(name).is_absolute() ? fs::path(name) : fs::path(file.path).parent_path() / name;
  if (fs::is_regular_file(found) && access(found.c_str(), X_OK) == 0) return found;
  if (is_path)
    throw LaunchError(service.program.mark, fmt::format("'{}' is no program that can be run", found.string()));
  std::set<std::string> known;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(programs, error)) {
    const std::string candidate = entry.path().filename();
    if (candidate.starts_with("splatbus-")) known.insert(candidate);
  }
  throw LaunchError(service.program.mark, fmt::format("unknown service: no program '{}' in {} (there are: {})", name,
                                                      programs.string(), joined(known)));
}

using Variables = std::map<std::string, std::string>;

std::string expand(std::string text, const Variables& variables) {
  for (const auto& [name, value] : variables) {
    const std::string reference = "${" + name + "}";
    for (std::size_t at = text.find(reference); at != std::string::npos; at = text.find(reference, at + value.size())) {
      text.replace(at, reference.size(), value);
    }
  }
  return text;
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
                         const LaunchFile& file, const bus::Address& file_bus) {
  const bus::Address address = service.bus ? bus::Address::parse(service.bus->value) : file_bus;
  const Variables variables{
      {"name", name}, {"replica", std::to_string(replica)}, {"bus_dir", address.directory.value_or("")}};
  ProcessPlan process;
  process.name = name;
  process.service = service.name;
  process.replica = replica;
  process.program = program;
  process.restart = service.restart;
  process.heartbeat_timeout_s = service.heartbeat_timeout_s;
  process.start_timeout_s = service.start_timeout_s;
  process.broker = is_broker(service);
  if (service.heartbeat_timeout_s > 0) process.arguments = {"--bus", address.text()};
  if (takes_parameters(service)) process.arguments.insert(process.arguments.end(), {"--name", name});
  for (const std::string& argument : service.args) process.arguments.push_back(expand(argument, variables));
  for (const auto& [key, setting] : service.parameters) {
    process.arguments.emplace_back("--set");
    process.arguments.push_back(key + "=" + expand(setting.value, variables));
  }
  process.environment = {{"SPLATBUS_BUS", address.text()}};
  // In the environment: a program that knows of no backends does not mind.
  if (const auto& backend = service.backend ? service.backend : file.backend) {
    process.backend = backend->value;
    process.environment["SPLATBUS_BACKEND"] = backend->value;
  }
  for (const auto& [key, value] : service.environment) process.environment[key] = expand(value, variables);
  return process;
}

/// Output and exit status of a program that is expected to end by itself; nullopt when it takes too long.
struct Answer {
  ExitStatus status;
  std::string output;
};

std::optional<Answer> ask(ChildProcess& child, int timeout_ms) {
  pollfd exit{.fd = child.exit_fd(), .events = POLLIN, .revents = 0};
  if (poll(&exit, 1, timeout_ms) <= 0) return {};
  const auto status = child.poll_exit();
  if (!status) return {};
  return Answer{*status, fmt::format("{}", fmt::join(child.read_lines(true), "\n"))};
}

}  // namespace

fs::path program_directory() {
  return fs::read_symlink("/proc/self/exe").parent_path();
}

LaunchPlan plan_launch(const LaunchFile& file, const bus::Address& bus, const fs::path& programs) {
  LaunchPlan plan{bus, {}};
  std::map<std::string, std::vector<std::size_t>> indices;  // of a service's replicas
  std::vector<std::size_t> brokers;
  std::map<std::string, SourceMark> names;
  for (const LaunchService* service : ordered(file)) {
    const fs::path program = find_program(*service, file, programs);
    if (!takes_parameters(*service) && !service->parameters.empty()) {
      throw LaunchError(service->parameters.begin()->second.mark,
                        fmt::format("'{}' takes no parameters: give it args", service->name));
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
      try {
        plan.processes.push_back(make_process(*service, program, name, ++replica, file, bus));
      } catch (const bus::Error& error) {
        throw LaunchError(service->bus->mark, error.what());
      }
      plan.processes.back().after.assign(after.begin(), after.end());
      own.push_back(plan.processes.size() - 1);
    }
    if (is_broker(*service)) brokers.insert(brokers.end(), own.begin(), own.end());
    indices[service->name] = std::move(own);
  }
  return plan;
}

std::vector<std::string> heartbeat_sources(const LaunchFile& file) {
  std::vector<std::string> sources;
  for (const LaunchService& service : file.services) {
    if (is_broker(service) || service.heartbeat_timeout_s <= 0 || service.bus) continue;
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

void check_parameters(const LaunchFile& file, const LaunchPlan& plan) {
  constexpr int kPatienceMs = 10000;
  struct Question {
    const LaunchService* service;
    ChildProcess child;
  };
  std::vector<Question> questions;
  for (const LaunchService& service : file.services) {
    if (service.parameters.empty()) continue;
    const std::string name = process_names(service).front();
    const auto process = std::find_if(plan.processes.begin(), plan.processes.end(),
                                      [&](const ProcessPlan& p) { return p.name == name; });
    if (process == plan.processes.end()) continue;
    std::vector<std::string> arguments = process->arguments;
    arguments.emplace_back("--parameters");
    questions.push_back({&service, ChildProcess(process->program, arguments, process->environment)});
  }
  for (Question& question : questions) {
    const auto answer = ask(question.child, kPatienceMs);
    if (!answer || answer->status.success()) continue;
    SourceMark mark = question.service->mark;
    for (const auto& [key, setting] : question.service->parameters) {
      if (answer->output.find("'" + key + "'") != std::string::npos) mark = setting.mark;
    }
    throw LaunchError(mark,
                      fmt::format("service '{}' refuses its parameters: {}", question.service->name, answer->output));
  }
}

std::filesystem::path default_launch_file(const std::string& name) {
  namespace fs = std::filesystem;
  fs::path relative = fs::path("launch") / name;
  if (fs::exists(relative)) return relative;
  const fs::path programs = program_directory();
  for (fs::path folder = programs; folder.has_relative_path(); folder = folder.parent_path()) {
    if (fs::exists(folder / relative)) return folder / relative;
  }
  throw std::runtime_error(relative.string() + " is neither here nor above " + programs.string() + "; give --launch");
}

}  // namespace splatbus::cli
