#include "launch_file.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <functional>
#include <sstream>

#include "yaml_reader.h"

namespace splatbus::cli {

namespace {

constexpr int kMaxReplicas = 64;

Marked<std::string> read_backend(const YamlReader& reader, const YAML::Node& node, const std::string& what) {
  const std::string backend = reader.scalar(node, what);
  if (backend != "cpu" && backend != "cuda" && backend != "auto") {
    reader.refuse(node, fmt::format("{} must be cpu, cuda or auto, not '{}'", what, backend));
  }
  return {backend, reader.mark(node)};
}

bool is_source_name(const std::string& name) {
  return !name.empty() && name.size() <= 64 && std::all_of(name.begin(), name.end(), [](unsigned char c) {
    return std::isalnum(c) != 0 || c == '-' || c == '_';
  });
}

LaunchService read_service(const YamlReader& reader, const YAML::Node& node) {
  LaunchService service;
  service.mark = reader.mark(node);
  if (!node.IsMap()) reader.refuse(node, "each entry of services must be a map with a name");
  const YAML::Node name = node["name"];
  if (!name) reader.refuse(node, "a service has no name");
  service.name = reader.scalar(name, "name");
  service.mark = reader.mark(name);
  if (!is_source_name(service.name)) {
    reader.refuse(name, fmt::format("service name '{}' may only have letters, digits, '-' and '_'", service.name));
  }
  service.program = {"splatbus-" + service.name, service.mark};

  const std::string of_service = fmt::format("of service '{}'", service.name);
  using Handler = std::function<void(const YAML::Node&)>;
  const std::map<std::string, Handler> handlers{
      {"name", [](const YAML::Node&) {}},
      {"program",
       [&](const YAML::Node& v) {
         service.program = {reader.scalar(v, "program " + of_service), reader.mark(v)};
       }},
      {"parameters",
       [&](const YAML::Node& v) {
         reader.each_entry(v, "parameters " + of_service, [&](const std::string& key, const auto&, const auto& value) {
           service.parameters[key] = {reader.scalar(value, fmt::format("parameter '{}' {}", key, of_service)),
                                      reader.mark(value)};
         });
       }},
      {"args",
       [&](const YAML::Node& v) {
         for (const auto& item : reader.list(v, "args " + of_service)) {
           service.args.push_back(reader.scalar(item, "each of args " + of_service));
         }
       }},
      {"environment",
       [&](const YAML::Node& v) {
         reader.each_entry(v, "environment " + of_service, [&](const std::string& key, const auto&, const auto& value) {
           service.environment[key] =
               reader.scalar(value, fmt::format("environment variable '{}' {}", key, of_service));
         });
       }},
      {"endpoint",
       [&](const YAML::Node& v) {
         service.parameters["endpoint"] = {reader.scalar(v, "endpoint " + of_service), reader.mark(v)};
       }},
      {"bus",
       [&](const YAML::Node& v) {
         service.bus = {reader.scalar(v, "bus " + of_service), reader.mark(v)};
       }},
      {"backend", [&](const YAML::Node& v) { service.backend = read_backend(reader, v, "backend " + of_service); }},
      {"replicas",
       [&](const YAML::Node& v) { service.replicas = reader.integer(v, "replicas " + of_service, 1, kMaxReplicas); }},
      {"restart",
       [&](const YAML::Node& v) {
         const std::string policy = reader.scalar(v, "restart " + of_service);
         if (policy == "always") {
           service.restart = RestartPolicy::Always;
         } else if (policy == "on-failure") {
           service.restart = RestartPolicy::OnFailure;
         } else if (policy == "never") {
           service.restart = RestartPolicy::Never;
         } else {
           reader.refuse(v,
                         fmt::format("restart {} must be always, on-failure or never, not '{}'", of_service, policy));
         }
       }},
      {"after",
       [&](const YAML::Node& v) {
         for (const auto& item : reader.list(v, "after " + of_service)) {
           service.after.push_back({reader.scalar(item, "each of after " + of_service), reader.mark(item)});
         }
       }},
      {"heartbeat_timeout_s",
       [&](const YAML::Node& v) {
         service.heartbeat_timeout_s = reader.seconds(v, "heartbeat_timeout_s " + of_service);
       }},
      {"start_timeout_s",
       [&](const YAML::Node& v) { service.start_timeout_s = reader.seconds(v, "start_timeout_s " + of_service); }},
  };
  reader.each_entry(node, fmt::format("service '{}'", service.name),
                    [&](const std::string& key, const YAML::Node& key_node, const YAML::Node& value) {
                      const auto handler = handlers.find(key);
                      if (handler == handlers.end()) {
                        std::string known;
                        for (const auto& [other, unused] : handlers) known += (known.empty() ? "" : ", ") + other;
                        reader.refuse(key_node, fmt::format("unknown key '{}' {} (known: {})", key, of_service, known));
                      }
                      handler->second(value);
                    });
  return service;
}

void check_names(const LaunchFile& file) {
  std::map<std::string, SourceMark> seen;
  for (const LaunchService& service : file.services) {
    const auto [first, inserted] = seen.emplace(service.name, service.mark);
    if (!inserted) {
      throw LaunchError(service.mark,
                        fmt::format("service name '{}' is taken, first at {}", service.name, first->second.text()));
    }
  }
}

void check_dependencies(const LaunchFile& file) {
  std::map<std::string, const LaunchService*> by_name;
  for (const LaunchService& service : file.services) by_name[service.name] = &service;

  std::map<std::string, bool> finished;  // false: on the path now
  std::vector<std::string> path;
  const std::function<void(const LaunchService&)> visit = [&](const LaunchService& service) {
    finished[service.name] = false;
    path.push_back(service.name);
    for (const auto& dependency : service.after) {
      const auto found = by_name.find(dependency.value);
      if (found == by_name.end()) {
        throw LaunchError(dependency.mark, fmt::format("service '{}' starts after '{}', which no entry is named",
                                                       service.name, dependency.value));
      }
      const auto state = finished.find(dependency.value);
      if (state == finished.end()) {
        visit(*found->second);
      } else if (!state->second) {
        const auto start = std::find(path.begin(), path.end(), dependency.value);
        throw LaunchError(dependency.mark, fmt::format("the services start after one another in a circle: {} after {}",
                                                       fmt::join(start, path.end(), " after "), dependency.value));
      }
    }
    path.pop_back();
    finished[service.name] = true;
  };
  for (const LaunchService& service : file.services) {
    if (!finished.contains(service.name)) visit(service);
  }
}

/// Refuses names that are taken, dependencies on nobody, and cycles, naming the way round.
void check_order(const LaunchFile& file) {
  check_names(file);
  check_dependencies(file);
}

constexpr const char* kTrainerProgram = "splatbus-trainer";

/// As a parameter of each trainer that has none of its own.
void give_world(LaunchFile& file) {
  if (!file.world) return;
  bool any = false;
  for (LaunchService& service : file.services) {
    if (std::filesystem::path(service.program.value).filename() != kTrainerProgram) continue;
    any = true;
    service.parameters.emplace("world", *file.world);
  }
  if (!any) throw LaunchError(file.world->mark, "there is no trainer to keep a world");
}

}  // namespace

std::string SourceMark::text() const {
  return line > 0 ? fmt::format("{}:{}:{}", file, line, column) : file;
}

LaunchService* LaunchFile::find(const std::string& name) {
  const auto found = std::find_if(services.begin(), services.end(), [&](const auto& s) { return s.name == name; });
  return found == services.end() ? nullptr : &*found;
}

LaunchFile read_launch_file(const std::string& path) {
  std::ifstream stream(path);
  std::ostringstream text;
  if (!stream || !(text << stream.rdbuf())) throw LaunchError(path + ": cannot be read, or is empty");
  return parse_launch_file(text.str(), path);
}

LaunchFile parse_launch_file(const std::string& yaml, const std::string& path) {
  const YamlReader reader(path);
  LaunchFile file;
  file.path = path;
  YAML::Node root;
  try {
    root = YAML::Load(yaml);
  } catch (const YAML::Exception& error) {
    throw LaunchError(reader.mark(error.mark), "not YAML: " + error.msg);
  }
  bool has_services = false;
  reader.each_entry(root, "a launch file", [&](const std::string& key, const auto& key_node, const auto& value) {
    if (key == "bus") {
      file.bus = {reader.scalar(value, "bus"), reader.mark(value)};
    } else if (key == "backend") {
      file.backend = read_backend(reader, value, "backend");
    } else if (key == "world") {
      const std::filesystem::path folder = reader.scalar(value, "world");
      const auto beside = folder.is_absolute() ? folder : std::filesystem::path(path).parent_path() / folder;
      file.world = {std::filesystem::absolute(beside).lexically_normal().string(), reader.mark(value)};
    } else if (key == "services") {
      has_services = true;
      for (const auto& node : reader.list(value, "services")) file.services.push_back(read_service(reader, node));
      if (file.services.empty()) reader.refuse(value, "services is empty");
    } else {
      reader.refuse(key_node, fmt::format("unknown key '{}' (known: backend, bus, services, world)", key));
    }
  });
  if (!has_services) reader.refuse(root, "a launch file needs the key services");
  check_order(file);
  give_world(file);
  return file;
}

void set_backend(LaunchFile& file, const std::string& backend) {
  if (!backend.empty()) file.backend = {backend, {"--backend " + backend, 0, 0}};
}

void set_world(LaunchFile& file, const std::string& folder) {
  if (folder.empty()) return;
  for (LaunchService& service : file.services) {
    if (file.world && service.parameters.contains("world") &&
        service.parameters.at("world").value == file.world->value) {
      service.parameters.erase("world");
    }
  }
  file.world = {std::filesystem::absolute(folder).lexically_normal().string(), {"--world " + folder, 0, 0}};
  give_world(file);
}

void apply_override(LaunchFile& file, const std::string& assignment) {
  const SourceMark mark{"--set " + assignment, 0, 0};
  const std::size_t equals = assignment.find('=');
  const std::size_t dot = assignment.find('.');
  if (equals == std::string::npos || dot == std::string::npos || dot > equals || dot == 0 || dot + 1 == equals) {
    throw LaunchError(mark, "expected service.key=value");
  }
  const std::string name = assignment.substr(0, dot);
  LaunchService* service = file.find(name);
  if (service == nullptr) {
    std::vector<std::string> known;
    for (const LaunchService& s : file.services) known.push_back(s.name);
    throw LaunchError(mark, fmt::format("{} has no service '{}' (known: {})", file.path, name, fmt::join(known, ", ")));
  }
  service->parameters[assignment.substr(dot + 1, equals - dot - 1)] = {assignment.substr(equals + 1), mark};
}

}  // namespace splatbus::cli
