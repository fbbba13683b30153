#include "launch_file.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <filesystem>
#include <functional>

#include "bus/nearest.h"
#include "launch_keys.h"

namespace splatbus::cli {

namespace {

constexpr const char* kTrainerProgram = "splatbus-trainer";

std::string lines_of(const std::vector<LaunchProblem>& problems) {
  std::string lines;
  for (const LaunchProblem& problem : problems) {
    lines += fmt::format("{}{}: {}", lines.empty() ? "" : "\n", problem.mark.text(), problem.text);
  }
  return lines;
}

}  // namespace

LaunchError::LaunchError(std::vector<LaunchProblem> problems)
    : std::runtime_error(lines_of(problems)), problems_(std::move(problems)) {}

std::string SourceMark::text() const {
  return line > 0 ? fmt::format("{}:{}:{}", file, line, column) : file;
}

LaunchService* LaunchFile::find(const std::string& name) {
  const auto found = std::find_if(services.begin(), services.end(), [&](const auto& s) { return s.name == name; });
  return found == services.end() ? nullptr : &*found;
}

std::vector<std::string> LaunchFile::service_names() const {
  std::vector<std::string> names;
  for (const LaunchService& service : services) names.push_back(service.name);
  return names;
}

void check_order(const LaunchFile& file) {
  std::map<std::string, const LaunchService*> by_name;
  for (const LaunchService& service : file.services) by_name[service.name] = &service;

  std::vector<LaunchProblem> problems;
  std::map<std::string, bool> finished;  // false: on the path now
  std::vector<std::string> path;
  const std::function<void(const LaunchService&)> visit = [&](const LaunchService& service) {
    finished[service.name] = false;
    path.push_back(service.name);
    for (const auto& dependency : service.after) {
      const auto found = by_name.find(dependency.value);
      if (found == by_name.end()) {
        problems.push_back({dependency.mark, fmt::format("`after` names unknown service '{}'{}", dependency.value,
                                                         bus::suggestion(dependency.value, file.service_names()))});
        continue;
      }
      const auto state = finished.find(dependency.value);
      if (state == finished.end()) {
        visit(*found->second);
      } else if (!state->second) {
        const auto start = std::find(path.begin(), path.end(), dependency.value);
        problems.push_back({dependency.mark, fmt::format("circular `after`: {} → {}",
                                                         fmt::join(start, path.end(), " → "), dependency.value)});
      }
    }
    path.pop_back();
    finished[service.name] = true;
  };
  for (const LaunchService& service : file.services) {
    if (!finished.contains(service.name)) visit(service);
  }
  if (!problems.empty()) throw LaunchError(std::move(problems));
}

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
    throw LaunchError(
        mark, fmt::format("{} has no service '{}'{}", file.path, name, bus::suggestion(name, file.service_names())));
  }
  service->parameters[assignment.substr(dot + 1, equals - dot - 1)] = {assignment.substr(equals + 1), mark};
}

}  // namespace splatbus::cli
