#include "operator_verbs.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <utility>

#include "bus/nearest.h"
#include "substitution.h"

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

/// What a process of a plan waits for, as the supervisor calls it: there a first replica has the name that it was
/// started by, whatever it would be called today.
std::vector<std::string> names_of(const std::vector<std::size_t>& after, const LaunchPlan& plan,
                                  const Statuses& there) {
  std::vector<std::string> names;
  for (const std::size_t index : after) {
    const ProcessPlan& planned = plan.processes.at(index);
    for (const ProcessStatus& process : there) {
      if (process.service == planned.service && process.replica == planned.replica) names.push_back(process.name);
    }
  }
  return names;
}

/// Of `names`, highest first, those that were started and did not stay; one that only waits for others does. Returns
/// which.
std::vector<std::string> remove_failed(const Operated& operated, const std::vector<std::string>& names, double wait_s,
                                       const std::stop_token& stop) {
  std::vector<std::string> failed;
  const Statuses all = operated.supervisor.status();
  const std::vector<std::string> highest_first(names.rbegin(), names.rend());
  for (const std::string& name : highest_first) {
    const auto process = std::ranges::find(all, name, &ProcessStatus::name);
    if (process == all.end()) continue;
    const bool ended = process->restarts > 0 || process->state == ProcessState::Failed;
    if (!ended && process->state != ProcessState::BackOff) break;
    operated.supervisor.remove(name);
    failed.push_back(name);
  }
  wait_for_end(operated, failed, wait_s, stop);
  return failed;
}

Json scale(Operated& operated, const Json& request, const ControlServer::Tell& tell, const std::stop_token& stop) {
  const auto turn = take_turn(operated, wait_s(request), tell);
  const std::string service_name = request.at("service").get<std::string>();
  const int wanted = request.at("replicas").get<int>();
  LaunchService* const service = operated.file.find(service_name);
  if (service == nullptr) {
    throw std::runtime_error(fmt::format("{} has no service '{}'{}", operated.file.path, service_name,
                                         bus::suggestion(service_name, operated.file.service_names())));
  }
  if (wanted < 0 || wanted > kMaxReplicas) {
    throw std::runtime_error(fmt::format("a service has 0 to {} replicas, not {}", kMaxReplicas, wanted));
  }
  const Statuses all = operated.supervisor.status();
  std::map<int, std::string> there;
  for (const ProcessStatus& process : all) {
    if (process.service == service_name) there[process.replica] = process.name;
  }
  LaunchFile changed = operated.file;
  changed.find(service_name)->replicas = std::max(wanted, 1);
  const LaunchPlan plan = plan_launch(changed, operated.bus, program_directory());
  std::vector<std::pair<ProcessPlan, std::vector<std::string>>> additions;
  for (const ProcessPlan& process : plan.processes) {
    if (process.service != service_name || process.replica > wanted || there.contains(process.replica)) continue;
    additions.emplace_back(process, names_of(process.after, plan, all));
  }
  // From here on nothing is refused.
  std::vector<std::string> added, removed;
  for (auto& [process, after] : additions) {
    added.push_back(process.name);
    tell(fmt::format("starting {}", process.name));
    operated.supervisor.add(std::move(process), std::move(after));
  }
  for (auto replica = there.rbegin(); replica != there.rend() && replica->first > wanted; ++replica) {
    tell(fmt::format("stopping {}", replica->second));
    operated.supervisor.remove(replica->second);
    wait_for_end(operated, {replica->second}, wait_s(request), stop);
    removed.push_back(replica->second);
  }
  service->replicas = std::max(wanted, 1);
  try {
    wait_for_running(operated, added, wait_s(request), stop);
  } catch (const std::exception& error) {
    const std::vector<std::string> failed = remove_failed(operated, added, wait_s(request), stop);
    if (failed.empty()) throw;
    service->replicas = std::max(wanted - static_cast<int>(failed.size()), 1);
    throw std::runtime_error(fmt::format("{}; removed again: {}", error.what(), fmt::join(failed, ", ")));
  }
  return {{"added", added}, {"removed", removed}};
}

/// A parameter that was written to the launch file counts from each process's next start on.
Json save(Operated& operated, const Json& request, const ControlServer::Tell& tell) {
  const auto turn = take_turn(operated, wait_s(request), tell);
  const std::string service = request.at("service").get<std::string>();
  const std::string key = request.at("key").get<std::string>(), value = request.at("value").get<std::string>();
  const auto names = processes_of(operated.supervisor.status(), service);
  for (const std::string& name : names) {
    operated.supervisor.change_plan(name, [&](ProcessPlan& plan) { set_parameter(plan, key, value); });
  }
  if (LaunchService* const entry = operated.file.find(service)) entry->parameters[key].value = escaped(value);
  return {{"processes", names}};
}

}  // namespace

std::unique_lock<std::timed_mutex> take_turn(const Operated& operated, double wait_s, const ControlServer::Tell& tell) {
  std::unique_lock turn(*operated.turn, std::try_to_lock);
  if (turn) return turn;
  tell("waiting for another scale, swap or save to end");
  if (!turn.try_lock_for(std::chrono::duration<double>(wait_s))) {
    throw std::runtime_error("another scale, swap or save is still under way");
  }
  return turn;
}

std::vector<std::string> processes_of(const std::vector<ProcessStatus>& all, const std::string& name) {
  std::vector<std::string> names;
  std::set<std::string> known;
  for (const ProcessStatus& process : all) {
    if (process.name == name) return {name};
    if (process.service == name) names.push_back(process.name);
    known.insert({process.service, process.name});
  }
  if (!names.empty()) return names;
  throw std::runtime_error(
      fmt::format("there is no service '{}'{}", name, bus::suggestion(name, {known.begin(), known.end()})));
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
  server.handle("stop", [operated](const Json& request, const Tell& tell, const Stop& stop) {
    auto names = asked_for(*operated, request);
    std::reverse(names.begin(), names.end());
    for (const std::string& name : names) {
      tell(fmt::format("stopping {}", name));
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
  server.handle("scale", [operated](const Json& request, const Tell& tell, const Stop& stop) {
    return scale(*operated, request, tell, stop);
  });
  server.handle("save", [operated](const Json& request, const Tell& tell, const Stop&) {
    return save(*operated, request, tell);
  });
  server.handle("down", [operated](const Json&, const Tell&, const Stop&) {
    std::vector<std::string> names;
    double within_s = 0;  // one after the other
    for (const ProcessStatus& process : operated->supervisor.status()) {
      if (process.pid == 0) continue;
      names.push_back(process.name);
      within_s += operated->supervisor.plan_of(process.name).stop_timeout_s;
    }
    operated->stop();
    return Json{{"processes", names}, {"stops_within_s", within_s}};
  });
}

}  // namespace splatbus::cli
