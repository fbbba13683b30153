#include "operator_verbs.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <mutex>
#include <nlohmann/json.hpp>
#include <set>
#include <utility>

namespace splatbus::cli {

namespace {

using Json = nlohmann::json;
using Statuses = std::vector<ProcessStatus>;

constexpr double kDefaultWaitS = 60;
constexpr int kMaxReplicas = 64;

Json to_json(const ProcessStatus& status, std::int64_t now_ns) {
  Json json{{"name", status.name},         {"service", status.service},
            {"replica", status.replica},   {"state", to_string(status.state)},
            {"restarts", status.restarts}, {"detail", status.detail},
            {"counters", status.counters}};
  if (status.pid != 0) {
    json["pid"] = status.pid;
    json["uptime_s"] = static_cast<double>(now_ns - status.started_ns) / 1e9;
  }
  if (status.beside) {
    json["beside"] = {{"role", status.beside->successor ? "successor" : "predecessor"},
                      {"state", status.beside->service_state},
                      {"detail", status.beside->detail}};
    if (status.beside->pid != 0) json["beside"]["pid"] = status.beside->pid;
  }
  return json;
}

Json status(const Operated& operated) {
  Json services = Json::array();
  const std::int64_t now = operated.now_ns();
  for (const ProcessStatus& process : operated.supervisor.status()) services.push_back(to_json(process, now));
  return {{"supervisor",
           {{"pid", getpid()},
            {"bus", operated.bus.text()},
            {"file", operated.file.path},
            {"log_folder", operated.log_folder}}},
          {"services", std::move(services)}};
}

/// On its way to where it shall be: nothing to be waited for any more when it is not.
bool on_the_way(const ProcessStatus& process) {
  switch (process.state) {
    case ProcessState::Waiting:
    case ProcessState::Starting:
    case ProcessState::BackOff:
    case ProcessState::Stopping:
      return true;
    default:
      return false;
  }
}

std::string describe(const ProcessStatus& process) {
  return fmt::format("{} is {}{}{}", process.name, to_string(process.state), process.detail.empty() ? "" : ": ",
                     process.detail);
}

/// Until each of them runs, or has ended with success; throws what is not.
void wait_for_running(const Operated& operated, const std::vector<std::string>& names, double wait_s,
                      const std::stop_token& stop) {
  const std::set<std::string> wanted(names.begin(), names.end());
  const auto chosen = [&](const Statuses& all) {
    Statuses result;
    for (const ProcessStatus& process : all) {
      if (wanted.contains(process.name)) result.push_back(process);
    }
    return result;
  };
  operated.supervisor.wait_until(
      [&](const Statuses& all) {
        const Statuses ours = chosen(all);
        return std::none_of(ours.begin(), ours.end(), on_the_way);
      },
      std::chrono::duration<double>(wait_s), stop);
  std::vector<std::string> wrong;
  for (const ProcessStatus& process : chosen(operated.supervisor.status())) {
    if (process.state != ProcessState::Running && process.state != ProcessState::Ended) {
      wrong.push_back(describe(process));
    }
  }
  if (!wrong.empty()) throw std::runtime_error(fmt::format("{}", fmt::join(wrong, "; ")));
}

void wait_for_end(const Operated& operated, const std::vector<std::string>& names, double wait_s,
                  const std::stop_token& stop) {
  const std::set<std::string> wanted(names.begin(), names.end());
  std::string left;
  const auto ended = [&](const Statuses& all) {
    left.clear();
    for (const ProcessStatus& process : all) {
      if (wanted.contains(process.name) && process.pid != 0) left = describe(process);
    }
    return left.empty();
  };
  if (!operated.supervisor.wait_until(ended, std::chrono::duration<double>(wait_s), stop)) {
    throw std::runtime_error(left);
  }
}

/// In the order of the plan, in which each comes after those that it waits for.
std::vector<std::string> asked_for(const Operated& operated, const Json& request) {
  const Statuses all = operated.supervisor.status();
  std::set<std::string> names;
  for (const auto& name : request.at("services")) {
    for (std::string& process : processes_of(all, name.get<std::string>())) names.insert(std::move(process));
  }
  std::vector<std::string> result;
  for (const ProcessStatus& process : all) {
    if (names.contains(process.name)) result.push_back(process.name);
  }
  return result;
}

double wait_s(const Json& request) {
  return request.value("wait_s", kDefaultWaitS);
}

Json scale(Operated& operated, const Json& request, const ControlServer::Tell& tell, const std::stop_token& stop) {
  const std::string service_name = request.at("service").get<std::string>();
  const int wanted = request.at("replicas").get<int>();
  LaunchService* const service = operated.file.find(service_name);
  if (service == nullptr) {
    throw std::runtime_error(fmt::format("{} has no service '{}'", operated.file.path, service_name));
  }
  if (wanted < 0 || wanted > kMaxReplicas) {
    throw std::runtime_error(fmt::format("a service has 0 to {} replicas, not {}", kMaxReplicas, wanted));
  }
  std::map<int, std::string> there;
  for (const ProcessStatus& process : operated.supervisor.status()) {
    if (process.service == service_name) there[process.replica] = process.name;
  }
  LaunchFile changed = operated.file;
  changed.find(service_name)->replicas = std::max(wanted, 1);
  std::vector<std::string> added, removed;
  for (ProcessPlan& plan : plan_launch(changed, operated.bus, program_directory()).processes) {
    if (plan.broker && wanted > 1 && plan.service == service_name) {
      throw std::runtime_error("a bus has one broker");
    }
    if (plan.service != service_name || plan.replica > wanted || there.contains(plan.replica)) continue;
    added.push_back(plan.name);
    tell(fmt::format("starting {}", plan.name));
    operated.supervisor.add(std::move(plan));
  }
  for (auto replica = there.rbegin(); replica != there.rend() && replica->first > wanted; ++replica) {
    tell(fmt::format("stopping {}", replica->second));
    operated.supervisor.remove(replica->second);
    wait_for_end(operated, {replica->second}, wait_s(request), stop);
    removed.push_back(replica->second);
  }
  service->replicas = std::max(wanted, 1);
  wait_for_running(operated, added, wait_s(request), stop);
  return {{"added", added}, {"removed", removed}};
}

/// A parameter that was written to the launch file counts from each process's next start on.
Json save(Operated& operated, const Json& request) {
  const std::string service = request.at("service").get<std::string>();
  const std::string key = request.at("key").get<std::string>(), value = request.at("value").get<std::string>();
  const auto names = processes_of(operated.supervisor.status(), service);
  for (const std::string& name : names) {
    operated.supervisor.change_plan(name, [&](ProcessPlan& plan) { set_parameter(plan, key, value); });
  }
  if (LaunchService* const entry = operated.file.find(service)) entry->parameters[key].value = value;
  return {{"processes", names}};
}

}  // namespace

std::vector<std::string> processes_of(const std::vector<ProcessStatus>& all, const std::string& name) {
  std::vector<std::string> names, known;
  for (const ProcessStatus& process : all) {
    if (process.name == name) return {name};
    if (process.service == name) names.push_back(process.name);
    known.push_back(process.name);
  }
  if (!names.empty()) return names;
  throw std::runtime_error(fmt::format("there is no service '{}' (there are: {})", name, fmt::join(known, ", ")));
}

void add_operator_verbs(ControlServer& server, const std::shared_ptr<Operated>& operated) {
  using Tell = ControlServer::Tell;
  using Stop = std::stop_token;
  server.handle("status", [operated](const Json&, const Tell&, const Stop&) { return status(*operated); });
  server.handle("wait", [operated](const Json& request, const Tell&, const Stop& stop) {
    std::vector<std::string> names;
    for (const ProcessStatus& process : operated->supervisor.status()) names.push_back(process.name);
    wait_for_running(*operated, names, wait_s(request), stop);
    return Json::object();
  });
  server.handle("start", [operated](const Json& request, const Tell&, const Stop& stop) {
    const auto names = asked_for(*operated, request);
    for (const std::string& name : names) operated->supervisor.start(name);
    wait_for_running(*operated, names, wait_s(request), stop);
    return Json{{"processes", names}};
  });
  server.handle("stop", [operated](const Json& request, const Tell&, const Stop& stop) {
    auto names = asked_for(*operated, request);
    std::reverse(names.begin(), names.end());
    for (const std::string& name : names) {
      operated->supervisor.stop(name);
      wait_for_end(*operated, {name}, wait_s(request), stop);
    }
    return Json{{"processes", names}};
  });
  server.handle("restart", [operated](const Json& request, const Tell& tell, const Stop& stop) {
    const auto names = asked_for(*operated, request);
    // One after the other: the replicas of a service are not all away at once.
    for (const std::string& name : names) {
      tell(fmt::format("restarting {}", name));
      operated->supervisor.restart(name);
      wait_for_running(*operated, {name}, wait_s(request), stop);
    }
    return Json{{"processes", names}};
  });
  // Those that change the launch file in memory: one at a time.
  const auto turn = std::make_shared<std::mutex>();
  server.handle("scale", [operated, turn](const Json& request, const Tell& tell, const Stop& stop) {
    const std::scoped_lock lock(*turn);
    return scale(*operated, request, tell, stop);
  });
  server.handle("save", [operated, turn](const Json& request, const Tell&, const Stop&) {
    const std::scoped_lock lock(*turn);
    return save(*operated, request);
  });
  server.handle("down", [operated](const Json&, const Tell&, const Stop&) {
    operated->stop();
    return Json::object();
  });
}

}  // namespace splatbus::cli
