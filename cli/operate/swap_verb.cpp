#include "swap_verb.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <iterator>
#include <nlohmann/json.hpp>
#include <utility>

#include "bus/clock.h"
#include "parameter_check.h"
#include "substitution.h"
#include "swap.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::json;
constexpr double kLeaveWithinS = 10;

/// A swap among a supervisor's processes.
class SupervisorSwapHost final : public SwapHost {
 public:
  SupervisorSwapHost(Supervisor& supervisor, ProcessPlan plan) : supervisor_(supervisor), plan_(std::move(plan)) {
    predecessor_ = status().pid;
    if (predecessor_ == 0) throw std::runtime_error(fmt::format("'{}' does not run", plan_.name));
  }

  [[nodiscard]] pid_t predecessor() const override { return predecessor_; }
  [[nodiscard]] pid_t start_successor() override {
    supervisor_.start_successor(plan_.name, plan_);
    const auto beside = status().beside;
    return beside ? beside->pid : 0;
  }
  [[nodiscard]] std::optional<std::string> successor_end() override {
    const auto beside = status().beside;
    if (!beside) return "it was dropped";
    if (!beside->exit) return std::nullopt;
    if (const auto line = std::ranges::find_if(beside->last_lines, refuses_successor);
        line != beside->last_lines.end()) {
      return fmt::format("{} cannot stand by beside it ({}); 'splatbus restart {}' starts another as it was",
                         plan_.program.filename().string(), *line, plan_.name);
    }
    const std::string how = beside->exit->text();
    return beside->last_lines.empty() ? how : fmt::format("{}: {}", how, beside->last_lines.back());
  }
  [[nodiscard]] bool predecessor_ended() override { return status().pid != predecessor_; }
  void exchange() override { supervisor_.exchange(plan_.name, kLeaveWithinS); }
  void drop_successor() override { supervisor_.drop_beside(plan_.name); }
  void restart_predecessor() override { supervisor_.restart(plan_.name); }

 private:
  /// What a program says that does not know the option.
  [[nodiscard]] static bool refuses_successor(const std::string& line) {
    constexpr std::array kRefusals{"not expected", "unrecognized", "unknown", "invalid", "unexpected"};
    return line.find("--successor") != std::string::npos &&
           std::ranges::any_of(kRefusals, [&](const char* word) { return line.find(word) != std::string::npos; });
  }
  [[nodiscard]] ProcessStatus status() const {
    for (ProcessStatus& process : supervisor_.status()) {
      if (process.name == plan_.name) return std::move(process);
    }
    throw std::runtime_error(fmt::format("there is no process '{}'", plan_.name));
  }

  Supervisor& supervisor_;
  ProcessPlan plan_;
  pid_t predecessor_ = 0;
};

/// The process's plan with what the request changes.
ProcessPlan changed_plan(ProcessPlan changed, const Json& request) {
  if (request.contains("program")) changed.program = request.at("program").get<std::string>();
  if (request.contains("backend")) {
    changed.backend = request.at("backend").get<std::string>();
    const auto before = std::ranges::find(changed.arguments, "--backend");  // of an earlier swap
    if (before != changed.arguments.end()) changed.arguments.erase(before, before + 2);
    changed.arguments.insert(changed.arguments.end(), {"--backend", changed.backend});
  }
  const Json changes = request.contains("set") ? request.at("set") : Json(Json::value_t::object);
  for (const auto& [key, value] : changes.items()) {
    set_parameter(changed, key, value.get<std::string>());
  }
  return changed;
}

ProcessPlan as_successor(ProcessPlan plan) {
  plan.arguments.emplace_back("--successor");
  return plan;
}

/// Two brokers cannot be on a bus at once: the new one is started once the old one has gone. What would fail for its
/// arguments is found before, and one that does not become ready makes way for one as it was.
void swap_broker(const Operated& operated, const ProcessPlan& before, const ProcessPlan& changed, double ready_s,
                 const ControlServer::Tell& tell, const std::stop_token& stop) {
  Supervisor& supervisor = operated.supervisor;
  const std::string& name = before.name;
  const auto report = ask_parameters(changed.program, changed.arguments, changed.environment);
  if (!report || !report->problems.empty()) {
    throw std::runtime_error(
        fmt::format("{} does not accept its arguments ('{} --parameters' says why); {} goes on as it was",
                    changed.program.string(), changed.program.filename().string(), name));
  }
  const auto start = [&](const ProcessPlan& plan) {
    supervisor.change_plan(name, [&](ProcessPlan& now) { now = plan; });
    supervisor.restart(name);
    std::string why = "it was not ready in time";
    const auto settled = [&](const std::vector<ProcessStatus>& all) {
      const auto broker = std::ranges::find(all, name, &ProcessStatus::name);
      if (broker == all.end() || broker->state == ProcessState::Running) return true;
      if (broker->state != ProcessState::BackOff && broker->state != ProcessState::Failed) return false;
      why = broker->detail;
      return true;
    };
    supervisor.wait_until(settled, std::chrono::duration<double>(ready_s), stop);
    const auto all = supervisor.status();
    const auto broker = std::ranges::find(all, name, &ProcessStatus::name);
    return broker != all.end() && broker->state == ProcessState::Running ? std::string() : why;
  };
  tell(fmt::format("{}: another broker takes its place; everything connects to it again", name));
  const std::string why = start(changed);
  if (why.empty()) return;
  tell(fmt::format("{}: the new broker is not ready: {}; the one before is started again", name, why));
  const bool is_back = start(before).empty();
  throw std::runtime_error(
      fmt::format("the new broker: {}; {}", why, is_back ? name + " was started again as it was" : name + " is gone"));
}

/// The one before the last swap may still be on its way out.
void wait_until_alone(const Supervisor& supervisor, const std::string& name, double wait_s,
                      const std::stop_token& stop) {
  const auto alone = [&](const std::vector<ProcessStatus>& all) {
    return std::ranges::none_of(all,
                                [&](const ProcessStatus& process) { return process.name == name && process.beside; });
  };
  if (supervisor.wait_until(alone, std::chrono::duration<double>(wait_s), stop)) return;
  throw std::runtime_error(
      fmt::format("the process of '{}' before the last swap has not ended within {:.3g} s", name, wait_s));
}

void swap_one(const Operated& operated, const std::string& name, const std::shared_ptr<bus::Context>& bus,
              const Json& request, const ControlServer::Tell& tell, const std::stop_token& stop) {
  SwapLimits limits{.ready_s = request.value("wait_s", SwapLimits{}.ready_s)};
  const std::int64_t begin_ns = bus::now_ns();
  wait_until_alone(operated.supervisor, name, limits.ready_s, stop);
  limits.ready_s -= static_cast<double>(bus::now_ns() - begin_ns) * 1e-9;  // one limit for both
  const ProcessPlan before = operated.supervisor.plan_of(name);
  const ProcessPlan changed = changed_plan(before, request);
  if (before.broker) return swap_broker(operated, before, changed, limits.ready_s, tell, stop);
  SupervisorSwapHost host(operated.supervisor, as_successor(changed));
  run_swap(
      host, bus, name, limits, [&](const std::string& text) { tell(fmt::format("{}: {}", name, text)); }, stop);
}

bool has_parameter(const ProcessPlan& plan, const std::string& assignment) {
  return std::ranges::adjacent_find(plan.arguments, [&](const std::string& option, const std::string& value) {
           return option == "--set" && value == assignment;
         }) != plan.arguments.end();
}

/// Once all of a service's processes are of the new kind, by one swap or one after the other, replicas that are planned
/// later are, too.
void remember(Operated& operated, const Json& request, const std::string& swapped) {
  const ProcessPlan first = operated.supervisor.plan_of(swapped);
  LaunchService* const entry = operated.file.find(first.service);
  if (entry == nullptr || first.broker) return;
  std::vector<ProcessPlan> all;
  for (const ProcessStatus& process : operated.supervisor.status()) {
    if (process.service == first.service) all.push_back(operated.supervisor.plan_of(process.name));
  }
  const SourceMark mark{"swap", 0, 0};
  if (request.contains("program") &&
      std::ranges::all_of(all, [&](const ProcessPlan& plan) { return plan.program == first.program; })) {
    entry->program = {first.program.string(), mark};
  }
  if (request.contains("backend") &&
      std::ranges::all_of(all, [&](const ProcessPlan& plan) { return plan.backend == first.backend; })) {
    entry->backend = {first.backend, mark};
    const auto before = std::ranges::find(entry->args, "--backend");  // which would go before the entry's
    if (before != entry->args.end() && std::next(before) != entry->args.end()) entry->args.erase(before, before + 2);
  }
  if (!request.contains("set")) return;
  for (const auto& [key, json] : request.at("set").items()) {
    const std::string value = json.get<std::string>(), assignment = fmt::format("{}={}", key, value);
    if (!std::ranges::all_of(all, [&](const ProcessPlan& plan) { return has_parameter(plan, assignment); })) continue;
    entry->parameters[key] = {escaped(value), mark};
  }
}

}  // namespace

void add_swap_handler(ControlServer& server, const std::shared_ptr<Operated>& operated) {
  server.handle("swap", [operated](const Json& request, const ControlServer::Tell& tell, const std::stop_token& stop) {
    const auto turn = take_turn(*operated, request.value("wait_s", SwapLimits{}.ready_s), tell);
    const auto names = processes_of(operated->supervisor.status(), request.at("service").get<std::string>());
    const auto bus = bus::Context::create(operated->bus, fmt::format("swap-{}", ::getpid()));
    std::vector<std::string> swapped;
    for (const std::string& name : names) {
      try {
        swap_one(*operated, name, bus, request, tell, stop);
      } catch (const std::exception& error) {
        if (swapped.empty()) throw;
        throw std::runtime_error(
            fmt::format("{}: {}; already swapped, and still so: {}", name, error.what(), fmt::join(swapped, ", ")));
      }
      swapped.push_back(name);
    }
    remember(*operated, request, names.front());
    return Json{{"processes", names}};
  });
}

}  // namespace splatbus::cli
