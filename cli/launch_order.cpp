#include "launch_order.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <functional>
#include <map>
#include <string>
#include <vector>

namespace splatbus::cli {

namespace {

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

}  // namespace

void check_order(const LaunchFile& file) {
  check_names(file);
  check_dependencies(file);
}

}  // namespace splatbus::cli
