// Starts, ends and signs of life.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <utility>

#include "supervisor.h"
#include "wire/system_generated.h"

namespace splatbus::cli {

namespace {

std::int64_t from_seconds(double seconds) {
  return static_cast<std::int64_t>(seconds * 1e9);
}

}  // namespace

double back_off_s(int attempts, double first_s, double max_s) {
  return std::min(std::ldexp(first_s, attempts - 1), max_s);
}

void Supervisor::ready(Process& process) {
  process.state = ProcessState::Running;
  process.was_ready = true;
  process.life->ready_ns = now_ns_();
  process.life->last_sign_ns = process.life->ready_ns;
  say(process, "ready", "ready", process.life->child->pid());
  if (!process.life->plan.broker) return;
  for (Process& other : processes_) other.life->last_sign_ns = process.life->ready_ns;
}

void Supervisor::reap(Process& process, bool stopping) {
  reap_beside(process);
  if (!process.life->child) return;
  const auto status = process.life->child->poll_exit();
  if (!status) return;
  pass_output(process, true);
  process.life->child.reset();
  process.life->stop_probes();
  if (stopping) {
    process.state = ProcessState::Ended;
  } else if (process.at_end != AtEnd::Policy) {
    ended_on_order(process);
  } else if (process.is_swapped()) {
    process.held = *status;
    process.state = ProcessState::Stopping;
    process.life->detail = "its successor takes over";
    say(process, "ended", "its process " + status->text(), 0, *status);
  } else {
    ended(process, *status);
  }
}

void Supervisor::ended(Process& process, const ExitStatus& status) {
  const std::int64_t now = now_ns_();
  const Life& life = *process.life;
  const RestartPolicy policy = life.plan.restart;
  if (process.state == ProcessState::Running && now - life.ready_ns > from_seconds(life.plan.restart_window_s)) {
    process.attempts = 0;
  }
  if (status.success() && policy != RestartPolicy::Always) {
    process.was_ready = true;  // what waits for it waits for its end at most
    process.state = ProcessState::Ended;
    say(process, "ended", "ended", 0, status);
    return;
  }
  if (policy == RestartPolicy::Never || status.permanent()) return fail(process, status.text(), status);
  start_later(process, status.text(), status);
}

void Supervisor::ended_on_order(Process& process) {
  const AtEnd at_end = std::exchange(process.at_end, AtEnd::Policy);
  if (at_end == AtEnd::StartAgain) {
    ++process.restarts;
    spawn(process);
    return;
  }
  process.state = ProcessState::Stopped;
  process.life->detail.clear();
  process.gone = at_end == AtEnd::Forget;
  say(process, "stopped", "stopped");
}

void Supervisor::start_later(Process& process, const std::string& reason, std::optional<ExitStatus> exit) {
  const int limit = process.life->plan.restart_attempts;
  if (++process.attempts >= limit && limit > 0) {
    return fail(process, fmt::format("{}, {} times in a row", reason, process.attempts), exit);
  }
  const double delay_s =
      back_off_s(process.attempts, process.life->plan.restart_delay_s, process.life->plan.restart_max_delay_s);
  process.next_start_ns = now_ns_() + from_seconds(delay_s);
  process.state = ProcessState::BackOff;
  process.life->detail = reason;
  say(process, "back-off", fmt::format("{}; starting it again in {:.1f} s", reason, delay_s), 0, exit, delay_s);
}

void Supervisor::start_what_is_due() {
  const std::int64_t now = now_ns_();
  const auto named = [&](const std::string& name) {
    return std::find_if(processes_.begin(), processes_.end(), [&](const Process& p) { return p.name == name; });
  };
  for (Process& process : processes_) {
    if (process.state == ProcessState::BackOff && now >= process.next_start_ns) {
      ++process.restarts;
      spawn(process);
    }
    if (process.state != ProcessState::Waiting) continue;
    bool all_ready = true;
    for (const std::string& name : process.after) {
      const auto other = named(name);
      if (other == processes_.end() || other->was_ready) continue;
      all_ready = false;
      if (other->state != ProcessState::Failed) continue;
      fail(process, fmt::format("waits for {}, which failed", name));
      break;
    }
    if (all_ready) spawn(process);
  }
}

void Supervisor::spawn(Process& process) {
  process.held.reset();
  process.state = ProcessState::Starting;
  try {
    start_child(*process.life);
  } catch (const StartedTooSoon& error) {
    return start_later(process, error.what());
  } catch (const std::runtime_error& error) {
    return fail(process, error.what());
  }
  const pid_t pid = process.life->child->pid();
  say(process, "started", fmt::format("started, process {}", pid), pid);
  if (process.life->plan.heartbeat_timeout_s <= 0 && !process.life->plan.readiness) ready(process);
}

void Supervisor::start_child(Life& life) {
  life.started_ns = now_ns_();
  life.last_sign_ns = life.started_ns;
  life.terminate_ns = 0;
  life.stop_probes();
  life.service_state.clear();
  life.detail.clear();
  life.last_line.clear();
  life.counters.clear();
  auto environment = life.plan.environment;
  environment.emplace("SPLATBUS_SUPERVISED", "1");
  environment.emplace("SPLATBUS_STOP_TIMEOUT_S", fmt::format("{}", life.plan.stop_timeout_s));
  life.child.emplace(life.plan.program, life.plan.arguments, environment, life.plan.nice);
}

void Supervisor::check_signs_of_life() {
  const std::int64_t now = now_ns_();
  const std::int64_t heard_until = bus_heard_until();
  for (Process& process : processes_) {
    Life& life = *process.life;
    if (!life.child || life.plan.heartbeat_timeout_s <= 0 || life.terminate_ns != 0) continue;
    const bool starting = process.state == ProcessState::Starting;
    const double limit_s = starting ? life.plan.start_timeout_s : life.plan.heartbeat_timeout_s;
    const std::int64_t judged_at = life.plan.broker ? now : heard_until;
    if (judged_at - life.last_sign_ns <= from_seconds(limit_s)) continue;
    kill(life, process, fmt::format("no heartbeat for {} s, killing it", limit_s));
  }
}

void Supervisor::kill(Life& life, const Process& process, const std::string& why) {
  say(process, "killed", why, life.child->pid());
  life.terminate_ns = now_ns_();
  life.child->signal_group(SIGKILL);
}

void Supervisor::check_probes() {
  const auto running = wire::EnumNameServiceState(wire::ServiceState::Running);
  for (Process& process : processes_) {
    Life& life = *process.life;
    const ProcessPlan& plan = life.plan;
    if (!life.child || life.terminate_ns != 0) continue;
    if (process.state == ProcessState::Starting && plan.readiness) {
      if (!life.readiness) life.readiness = std::make_unique<ProbeRunner>(*plan.readiness);
      const bool beats = plan.heartbeat_timeout_s <= 0 || life.service_state == running;
      if (beats && life.readiness->was_good()) {
        life.readiness.reset();
        ready(process);
      } else if ((beats ? now_ns_() : bus_heard_until()) - life.started_ns > from_seconds(plan.start_timeout_s)) {
        kill(life, process, fmt::format("not ready within {} s, killing it", plan.start_timeout_s));
      }
    } else if (process.state == ProcessState::Running && plan.liveness) {
      if (!life.liveness) life.liveness = std::make_unique<ProbeRunner>(*plan.liveness);
      if (life.liveness->fails()) kill(life, process, "its liveness probe fails, killing it");
    }
  }
}

void Supervisor::kill_what_does_not_stop() {
  const std::int64_t now = now_ns_();
  const auto overdue = [&](const Life& life) {
    return life.child && life.terminate_ns != 0 && now - life.terminate_ns > from_seconds(life.plan.stop_timeout_s);
  };
  const auto end = [&](const Process& process, Life& life) {
    if (!overdue(life)) return;
    kill(life, process, "does not stop, killing it");
  };
  for (Process& process : processes_) {
    if (process.state == ProcessState::Stopping) end(process, *process.life);
    if (!process.beside) continue;
    Beside& beside = *process.beside;
    Life& life = *beside.life;
    if (life.child && beside.leave_by_ns != 0 && life.terminate_ns == 0 && now >= beside.leave_by_ns) {
      life.terminate_ns = now;
      life.child->signal_group(SIGTERM);
    }
    end(process, life);
  }
}

std::int64_t Supervisor::bus_heard_until() const {
  std::int64_t until = now_ns_();
  for (const Process& process : processes_) {
    if (!process.life->plan.broker) continue;
    until = process.state == ProcessState::Running ? std::min(until, process.life->last_sign_ns) : 0;
  }
  return until;
}

void Supervisor::fail(Process& process, const std::string& reason, std::optional<ExitStatus> exit) {
  process.state = ProcessState::Failed;
  const std::string& said = process.life->last_line;
  process.life->detail = exit && !said.empty() ? fmt::format("{}: {}", reason, said) : reason;
  {
    const std::scoped_lock lock(mutex_);
    failures_.emplace_back(process.name, reason);
  }
  say(process, "failed", "failed: " + reason, 0, exit);  // whoever reads that line finds the failure
}

}  // namespace splatbus::cli
