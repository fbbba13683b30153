#include <fmt/format.h>
#include <fmt/ranges.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <stdexcept>
#include <variant>
#include <vector>

#include "bus/nearest.h"
#include "control_request.h"
#include "control_socket.h"
#include "launch_plan.h"
#include "parameter_edit.h"
#include "parameter_query.h"
#include "schema_json.h"
#include "verbs.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;

struct ParamOptions {
  std::string bus, service, key, value;
  std::string file;  ///< launch file to save to
  bool save = false;
  bool json = false;
};

const bus::ParameterDescription* find(const std::optional<bus::ParameterReport>& report, const std::string& key) {
  if (!report) return nullptr;
  const auto found = std::find_if(report->parameters.begin(), report->parameters.end(),
                                  [&](const auto& parameter) { return parameter.name == key; });
  return found == report->parameters.end() ? nullptr : &*found;
}

/// A number or a boolean where it is declared so.
nlohmann::json value_json(const ParameterOwner& owner, const std::string& key, const std::string& text) {
  const auto type = owner.types.find(key);
  if (type == owner.types.end()) return text;
  return std::visit([](const auto& value) { return nlohmann::json(value); }, bus::typed_value(text, type->second));
}

void print(const ParameterOwner& owner, const bus::ParameterDescription& parameter, bool known) {
  if (!known) {
    fmt::print("{}.{} = {}\n", owner.source, parameter.name, parameter.value);
    return;
  }
  const std::string bounds = parameter.bounds.empty() ? "" : " " + parameter.bounds;
  fmt::print("{}.{} = {}\n    {}\n    {}{}, default {}{}\n", owner.source, parameter.name, parameter.value,
             parameter.text, parameter.type, bounds,
             parameter.default_value.empty() ? "empty" : parameter.default_value,
             parameter.at_start ? ", fixed at start" : "");
}

int list(const ParamOptions& options) {
  const auto context = connect(bus_address(options.bus));
  bool any = false;
  for (const ParameterOwner& owner : find_owners(context, options.service)) {
    const auto report = owner.values.empty() ? std::nullopt : ask_program(owner.kind, {}, program_directory());
    for (const auto& [name, value] : owner.values) {
      const auto* known = find(report, name);
      bus::ParameterDescription parameter;
      if (known != nullptr) parameter = *known;
      parameter.name = name;
      parameter.value = value;
      any = true;
      if (!options.json) {
        print(owner, parameter, known != nullptr);
        continue;
      }
      nlohmann::json json{
          {"service", owner.source}, {"kind", owner.kind}, {"name", name}, {"value", value_json(owner, name, value)}};
      if (known != nullptr) {
        json.update({{"type", parameter.type},
                     {"bounds", parameter.bounds},
                     {"default", value_json(owner, name, parameter.default_value)},
                     {"text", parameter.text},
                     {"at_start", parameter.at_start}});
      }
      fmt::print("{}\n", json_text(json));
    }
  }
  if (!any) throw std::runtime_error(fmt::format("'{}' has no parameters", options.service));
  return 0;
}

[[noreturn]] void refuse_key(const ParameterOwner& owner, const std::string& key) {
  if (owner.values.empty()) throw std::runtime_error(fmt::format("'{}' has no parameters", owner.source));
  const std::string meant = bus::nearest(key, owner.names());
  throw std::runtime_error(fmt::format("{} has no parameter '{}'; {}", owner.source, key,
                                       meant.empty() ? fmt::format("'splatbus param list {}' names them", owner.source)
                                                     : fmt::format("did you mean '{}'?", meant)));
}

int get(const ParamOptions& options) {
  const auto context = connect(bus_address(options.bus));
  for (const ParameterOwner& owner : find_owners(context, options.service)) {
    const std::string* value = owner.find(options.key);
    if (value == nullptr) refuse_key(owner, options.key);
    if (options.json) {
      fmt::print("{}\n", json_text({{"service", owner.source},
                                    {"name", options.key},
                                    {"value", value_json(owner, options.key, *value)}}));
    } else {
      fmt::print("{}\n", *value);
    }
  }
  return 0;
}

/// A variable of a process's environment, as it was started; empty when that cannot be read.
std::string variable_of(std::uint32_t pid, const std::string& name) {
  std::ifstream environment(fmt::format("/proc/{}/environ", pid));
  for (std::string entry; std::getline(environment, entry, '\0');) {
    if (entry.starts_with(name + "=")) return entry.substr(name.size() + 1);
  }
  return {};
}

/// So that a restart has what the launch file says now. Where nobody supervises, the next launch reads it.
void tell_supervisor(const bus::Address& bus, const std::string& service, const ParamOptions& options) {
  constexpr double kTurnS = 10;
  try {
    static_cast<void>(ask_supervisor(
        bus,
        {{"verb", "save"}, {"service", service}, {"key", options.key}, {"value", options.value}, {"wait_s", kTurnS}}));
  } catch (const NoSupervisor&) {
  }
}

/// Launch files with those of their entries that the processes were started by, or of the file that is named.
using Entries = std::map<std::string, std::set<std::string>>;

Entries entries_of(const ParamOptions& options, const std::vector<ParameterOwner>& owners, bool local) {
  Entries entries;
  for (const ParameterOwner& owner : owners) {
    const std::string file =
        !options.file.empty() ? options.file : (local ? variable_of(owner.pid, kLaunchFileVariable) : "");
    if (file.empty()) {
      throw std::runtime_error(
          fmt::format("{} was not started here by a launch file: name one with --file", owner.source));
    }
    const std::string started_as = local ? variable_of(owner.pid, kLaunchServiceVariable) : "";
    entries[file].insert(started_as.empty() ? owner.source : started_as);
  }
  return entries;
}

std::string text_of(const std::string& file) {
  std::ifstream stream(file);
  std::string text{std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
  if (!stream) throw std::runtime_error(file + ": cannot be read");
  return text;
}

/// Beside it, and in its place once it is whole: whoever reads it finds the one or the other.
void replace(const fs::path& target, const std::string& text) {
  const fs::path draft = target.string() + ".new";
  std::ofstream out(draft);
  out << text;
  out.close();
  if (!out) throw std::runtime_error(draft.string() + ": cannot be written");
  fs::permissions(draft, fs::status(target).permissions());
  fs::rename(draft, target);
}

/// Writes the parameter to every entry, once all of them are known to take it.
void save(const ParamOptions& options, const Entries& entries) {
  std::map<std::string, std::string> texts;
  for (const auto& [file, services] : entries) {
    std::string text = text_of(file);
    for (const std::string& service : services) {
      text = with_parameters(text, file, service, {{options.key, options.value}});
    }
    texts[file] = std::move(text);
  }
  for (const auto& [file, text] : texts) {
    const fs::path target = fs::canonical(file);
    replace(target, text);
    const auto& services = entries.at(file);
    if (options.json) continue;
    fmt::print("saved in {}{}\n", target.string(),
               services.size() > 1 ? fmt::format(", for {}", fmt::join(services, " and ")) : "");
  }
}

int set(const ParamOptions& options) {
  const bus::Address address = bus_address(options.bus);
  const auto context = connect(address);
  const auto owners = find_owners(context, options.service);
  for (const ParameterOwner& owner : owners) {
    bool restart = false;
    if (owner.find(options.key) == nullptr) refuse_key(owner, options.key);
    const auto report = ask_program(owner.kind, {{options.key, options.value}}, program_directory());
    if (report && !report->problems.empty()) throw std::runtime_error(report->problems.front().text);
    const auto* known = find(report, options.key);
    const std::string before = *owner.find(options.key);
    std::string now = before;
    if (known != nullptr && known->at_start) {
      restart = true;
      if (!options.save) {
        throw std::runtime_error(
            fmt::format("parameter '{}' is fixed while {} runs: save it with --save and restart {}", options.key,
                        owner.source, owner.source));
      }
    } else {
      now = set_parameter(context, owner, options.key, options.value);
      if (known != nullptr && now != known->value) {
        throw std::runtime_error(fmt::format("{} still has {} = {}", owner.source, options.key, now));
      }
    }
    if (options.json) {
      fmt::print("{}\n", json_text({{"service", owner.source},
                                    {"name", options.key},
                                    {"before", value_json(owner, options.key, before)},
                                    {"value", value_json(owner, options.key, now)},
                                    {"needs_restart", restart}}));
    } else if (restart) {
      fmt::print("{}.{} is {} until {} is restarted\n", owner.source, options.key, before, owner.source);
    } else {
      fmt::print("{}.{} = {} (was {})\n", owner.source, options.key, now, before);
    }
  }
  if (!options.save) return 0;
  const Entries entries = entries_of(options, owners, address.is_local());
  save(options, entries);
  if (!options.file.empty()) return 0;
  for (const auto& [file, services] : entries) {
    for (const std::string& service : services) tell_supervisor(address, service, options);
  }
  return 0;
}

CLI::App* add_verb(CLI::App& parent, const char* name, const char* text, const std::shared_ptr<ParamOptions>& options,
                   bool service_required) {
  CLI::App* verb = parent.add_subcommand(name, text);
  verb->add_option("service", options->service, "name or kind of a service")->required(service_required);
  verb->add_flag("--json", options->json, "print JSON, one object per line");
  add_bus_option(*verb, options->bus);
  return verb;
}

}  // namespace

void add_param_verb(CLI::App& app, Action& action) {
  CLI::App* param = app.add_subcommand("param", "List, read and change parameters of running services");
  param->require_subcommand(1);
  auto options = std::make_shared<ParamOptions>();

  CLI::App* verb =
      add_verb(*param, "list", "Print parameters with value, text, type, range and default", options, false);
  verb->callback([options, &action] { action = [options] { return list(*options); }; });

  verb = add_verb(*param, "get", "Print the value of a parameter", options, true);
  verb->add_option("key", options->key, "name of the parameter")->required();
  verb->callback([options, &action] { action = [options] { return get(*options); }; });

  verb = add_verb(*param, "set", "Change a parameter and wait until the service has it", options, true);
  verb->add_option("key", options->key, "name of the parameter")->required();
  verb->add_option("value", options->value, "new value; write -- before a negative number")->required();
  verb->add_flag("--save", options->save, "write it to the launch file too; comments and layout stay");
  verb->add_option("--file", options->file, "launch file for --save (default: the one the service was started from)");
  verb->callback([options, &action] { action = [options] { return set(*options); }; });
}

}  // namespace splatbus::cli
