#include "supervisor.h"

#include <fmt/format.h>
#include <unistd.h>
#include <zmq.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <utility>

#include "wire/system_generated.h"

namespace splatbus::cli {

namespace {

constexpr std::int64_t kSecond = 1'000'000'000;
constexpr int kPollMs = 50;
constexpr const char* kBrokerSource = "bus";
constexpr double kFirstBackOffS = 0.1;
constexpr double kMaxBackOffS = 8;
constexpr std::int64_t kHealthy = 10 * kSecond;  ///< ready for that long: earlier ends are forgotten
constexpr int kMaxAttempts = 8;
constexpr std::int64_t kTerminateTimeout = 3 * kSecond;

std::int64_t from_seconds(double seconds) {
  return static_cast<std::int64_t>(seconds * static_cast<double>(kSecond));
}

}  // namespace

double back_off_s(int attempts) {
  return std::min(std::ldexp(kFirstBackOffS, attempts - 1), kMaxBackOffS);
}

const char* to_string(ProcessState state) {
  switch (state) {
    case ProcessState::Waiting:
      return "waiting";
    case ProcessState::Starting:
      return "starting";
    case ProcessState::Running:
      return "running";
    case ProcessState::BackOff:
      return "back-off";
    case ProcessState::Ended:
      return "ended";
    case ProcessState::Failed:
      return "failed";
  }
  return "?";
}

Supervisor::Supervisor(LaunchPlan plan, Output output, Clock now_ns)
    : output_(std::move(output)),
      now_ns_(std::move(now_ns)),
      heartbeats_(bus::Context::create(plan.bus, fmt::format("supervisor-{}", getpid()))) {
  heartbeats_.on(topics::kHeartbeat, [this](const wire::Heartbeat& heartbeat, const bus::Message& message) {
    take(heartbeat, message.header().source()->string_view());
  });
  for (ProcessPlan& process_plan : plan.processes) {
    Process process;
    process.status.name = process_plan.name;
    process.plan = std::move(process_plan);
    processes_.push_back(std::move(process));
  }
  publish_status();
}

Supervisor::~Supervisor() = default;

bool Supervisor::run(const std::stop_token& stop, const std::stop_token& kill) {
  while (!stop.stop_requested() && anything_to_do()) {
    start_what_is_due();
    wait_for_events();
    heartbeats_.dispatch_all(std::chrono::milliseconds(0));
    for (Process& process : processes_) reap(process, false);
    check_signs_of_life();
    publish_status();
  }
  while (std::any_of(processes_.begin(), processes_.end(), [](const Process& p) { return p.child.has_value(); })) {
    terminate_in_order(kill.stop_requested());
    wait_for_events();
    for (Process& process : processes_) reap(process, true);
    publish_status();
  }
  return !failure().has_value();
}

std::vector<ProcessStatus> Supervisor::status() const {
  const std::scoped_lock lock(mutex_);
  return published_;
}

std::optional<std::string> Supervisor::failure() const {
  const std::scoped_lock lock(mutex_);
  return failure_;
}

void Supervisor::wait_for_events() {
  std::vector<zmq_pollitem_t> items{{heartbeats_.zmq_socket(), 0, ZMQ_POLLIN, 0}};
  for (const Process& process : processes_) {
    if (!process.child) continue;
    items.push_back({nullptr, process.child->exit_fd(), ZMQ_POLLIN, 0});
    if (process.child->output_fd() >= 0) items.push_back({nullptr, process.child->output_fd(), ZMQ_POLLIN, 0});
  }
  zmq_poll(items.data(), static_cast<int>(items.size()), kPollMs);
  for (Process& process : processes_) pass_output(process, false);
}

void Supervisor::pass_output(Process& process, bool rest) {
  if (!process.child) return;
  for (const std::string& line : process.child->read_lines(rest)) output_(process.plan.name, line, false);
}

void Supervisor::take(const wire::Heartbeat& heartbeat, std::string_view source) {
  Process* const process = sender(source, static_cast<pid_t>(heartbeat.pid()));
  if (process == nullptr) return;
  process->last_sign_ns = now_ns_();
  process->status.detail = heartbeat.detail() != nullptr ? heartbeat.detail()->str() : "";
  process->status.counters.clear();
  if (heartbeat.counters() != nullptr) {
    for (const auto* counter : *heartbeat.counters()) {
      process->status.counters[counter->name()->str()] = counter->value();
    }
  }
  if (process->status.state == ProcessState::Starting) ready(*process);
}

/// By name, since another machine's process may have the same id; and by id, since the broker also hands out the last
/// heartbeat of those that are gone. The broker's name on the bus is its own, whatever the launch file calls it.
Supervisor::Process* Supervisor::sender(std::string_view source, pid_t pid) {
  const auto found = std::find_if(processes_.begin(), processes_.end(), [&](const Process& process) {
    return process.child && process.child->pid() == pid &&
           source == (process.plan.broker ? kBrokerSource : process.plan.name);
  });
  return found == processes_.end() ? nullptr : &*found;
}

void Supervisor::ready(Process& process) {
  process.status.state = ProcessState::Running;
  process.was_ready = true;
  process.ready_ns = now_ns_();
  process.last_sign_ns = process.ready_ns;
  if (!process.plan.broker) return;
  for (Process& other : processes_) other.last_sign_ns = process.ready_ns;
}

void Supervisor::reap(Process& process, bool stopping) {
  if (!process.child) return;
  const auto status = process.child->poll_exit();
  if (!status) return;
  pass_output(process, true);
  process.child.reset();
  process.status.pid = 0;
  if (stopping) {
    process.status.state = ProcessState::Ended;
  } else {
    ended(process, *status);
  }
}

void Supervisor::ended(Process& process, const ExitStatus& status) {
  const std::int64_t now = now_ns_();
  if (process.status.state == ProcessState::Running && now - process.ready_ns > kHealthy) process.attempts = 0;
  const RestartPolicy policy = process.plan.restart;
  if (status.success() && policy != RestartPolicy::Always) {
    process.was_ready = true;  // what waits for it waits for its end at most
    process.status.state = ProcessState::Ended;
    say(process, "ended");
    return;
  }
  if (policy == RestartPolicy::Never) return fail(process, status.text());
  start_later(process, status.text());
}

void Supervisor::start_later(Process& process, const std::string& reason) {
  if (++process.attempts >= kMaxAttempts) {
    return fail(process, fmt::format("{}, {} times in a row", reason, process.attempts));
  }
  const double delay_s = back_off_s(process.attempts);
  process.next_start_ns = now_ns_() + from_seconds(delay_s);
  process.status.state = ProcessState::BackOff;
  process.status.detail = reason;
  say(process, fmt::format("{}; starting it again in {:.1f} s", reason, delay_s));
}

void Supervisor::start_what_is_due() {
  const std::int64_t now = now_ns_();
  for (Process& process : processes_) {
    if (process.status.state == ProcessState::BackOff && now >= process.next_start_ns) {
      ++process.status.restarts;
      start(process);
    }
    if (process.status.state != ProcessState::Waiting) continue;
    const auto failed = std::find_if(process.plan.after.begin(), process.plan.after.end(),
                                     [&](std::size_t i) { return processes_[i].status.state == ProcessState::Failed; });
    if (failed != process.plan.after.end()) {
      fail(process, fmt::format("waits for {}, which failed", processes_[*failed].plan.name));
    } else if (std::all_of(process.plan.after.begin(), process.plan.after.end(),
                           [&](std::size_t i) { return processes_[i].was_ready; })) {
      start(process);
    }
  }
}

void Supervisor::start(Process& process) {
  process.started_ns = now_ns_();
  process.last_sign_ns = process.started_ns;
  process.terminate_ns = 0;
  process.status.state = ProcessState::Starting;
  process.status.detail.clear();
  try {
    process.child.emplace(process.plan.program, process.plan.arguments, process.plan.environment);
  } catch (const StartedTooSoon& error) {
    return start_later(process, error.what());
  } catch (const std::runtime_error& error) {
    return fail(process, error.what());
  }
  process.status.pid = process.child->pid();
  say(process, fmt::format("started, process {}", process.status.pid));
  if (process.plan.heartbeat_timeout_s <= 0) ready(process);
}

void Supervisor::check_signs_of_life() {
  const std::int64_t now = now_ns_();
  const std::int64_t heard_until = bus_heard_until();
  for (Process& process : processes_) {
    if (!process.child || process.plan.heartbeat_timeout_s <= 0 || process.terminate_ns != 0) continue;
    const bool starting = process.status.state == ProcessState::Starting;
    const double limit_s = starting ? process.plan.start_timeout_s : process.plan.heartbeat_timeout_s;
    const std::int64_t judged_at = process.plan.broker ? now : heard_until;
    if (judged_at - process.last_sign_ns <= from_seconds(limit_s)) continue;
    say(process, fmt::format("no heartbeat for {} s, killing it", limit_s));
    process.terminate_ns = now;
    process.child->signal_group(SIGKILL);
  }
}

std::int64_t Supervisor::bus_heard_until() const {
  std::int64_t until = now_ns_();
  for (const Process& process : processes_) {
    if (!process.plan.broker) continue;
    until = process.status.state == ProcessState::Running ? std::min(until, process.last_sign_ns) : 0;
  }
  return until;
}

bool Supervisor::anything_to_do() const {
  return std::any_of(processes_.begin(), processes_.end(), [](const Process& process) {
    return process.status.state != ProcessState::Ended && process.status.state != ProcessState::Failed;
  });
}

void Supervisor::terminate_in_order(bool kill) {
  const std::int64_t now = now_ns_();
  for (std::size_t i = 0; i < processes_.size(); ++i) {
    Process& process = processes_[i];
    if (!process.child) continue;
    const bool needed = std::any_of(processes_.begin(), processes_.end(), [&](const Process& other) {
      return other.child && std::find(other.plan.after.begin(), other.plan.after.end(), i) != other.plan.after.end();
    });
    if (kill) {
      process.child->signal_group(SIGKILL);
    } else if (process.terminate_ns == 0) {
      if (needed) continue;
      process.terminate_ns = now;
      process.child->signal_group(SIGTERM);
    } else if (now - process.terminate_ns > kTerminateTimeout) {
      say(process, "does not stop, killing it");
      process.terminate_ns = now;
      process.child->signal_group(SIGKILL);
    }
  }
}

void Supervisor::fail(Process& process, const std::string& reason) {
  process.status.state = ProcessState::Failed;
  process.status.detail = reason;
  {
    const std::scoped_lock lock(mutex_);
    if (!failure_) failure_ = process.plan.name + ": " + reason;
  }
  say(process, "failed: " + reason);  // whoever reads that line finds the failure
}

void Supervisor::say(const Process& process, const std::string& text) const {
  output_(process.plan.name, text, true);
}

void Supervisor::publish_status() {
  const std::scoped_lock lock(mutex_);
  published_.clear();
  for (const Process& process : processes_) published_.push_back(process.status);
}

}  // namespace splatbus::cli
