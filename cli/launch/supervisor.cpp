#include "supervisor.h"

#include <fmt/format.h>
#include <sys/eventfd.h>
#include <unistd.h>
#include <zmq.h>

#include <algorithm>
#include <csignal>
#include <string_view>
#include <utility>

#include "wire/system_generated.h"

namespace splatbus::cli {

namespace {

constexpr int kPollMs = 50;
constexpr const char* kBrokerSource = "bus";

/// Whether a line of a process's output may be the reason of its end; CLI11 says last how to get help.
bool says_why(std::string_view line) {
  return line.find_first_not_of(" \t") != std::string_view::npos && !line.starts_with("Run with --help");
}

}  // namespace

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
    case ProcessState::Stopping:
      return "stopping";
    case ProcessState::Stopped:
      return "stopped";
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
      heartbeats_(bus::Context::create(plan.bus, fmt::format("supervisor-{}", getpid()))),
      wake_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
  heartbeats_.on(topics::kHeartbeat, [this](const wire::Heartbeat& heartbeat, const bus::Message& message) {
    take(heartbeat, message.header().source()->string_view());
  });
  std::vector<std::string> names;
  for (const ProcessPlan& process : plan.processes) names.push_back(process.name);
  for (ProcessPlan& process_plan : plan.processes) {
    Process& process = processes_.emplace_back();
    process.name = process_plan.name;
    for (const std::size_t index : process_plan.after) process.after.push_back(names.at(index));
    process.life->plan = std::move(process_plan);
  }
  publish_status();
}

Supervisor::~Supervisor() = default;

bool Supervisor::run(const std::stop_token& stop, const std::stop_token& kill) {
  // Also where this throws: whoever waits for an order would wait for ever.
  const std::unique_ptr<Supervisor, void (*)(Supervisor*)> over(this, [](Supervisor* self) { self->refuse_orders(); });
  while (!stop.stop_requested() && anything_to_do()) {
    start_what_is_due();
    wait_for_events();
    obey_orders();
    heartbeats_.dispatch_all(std::chrono::milliseconds(0));
    for (Process& process : processes_) reap(process, false);
    processes_.remove_if([](const Process& process) { return process.gone; });
    check_signs_of_life();
    check_probes();
    kill_what_does_not_stop();
    publish_status();
  }
  note_what_does_not_run();
  refuse_orders();
  const auto lives = [](const Process& p) { return p.life->child || (p.beside && p.beside->life->child); };
  while (std::any_of(processes_.begin(), processes_.end(), lives)) {
    terminate_in_order(kill.stop_requested());
    wait_for_events();
    for (Process& process : processes_) reap(process, true);
    publish_status();
  }
  return not_running().empty();
}

std::vector<ProcessStatus> Supervisor::status() const {
  const std::scoped_lock lock(mutex_);
  return published_;
}

std::optional<std::string> Supervisor::failure() const {
  const std::scoped_lock lock(mutex_);
  if (failures_.empty()) return {};
  return fmt::format("{}: {}", failures_.front().first, failures_.front().second);
}

std::vector<std::string> Supervisor::not_running() const {
  const std::scoped_lock lock(mutex_);
  return not_running_;
}

bool Supervisor::wait_until(const Condition& condition, std::chrono::duration<double> timeout,
                            const std::stop_token& stop) const {
  std::unique_lock lock(mutex_);
  const auto holds = [&] { return condition(published_); };
  changed_.wait_for(lock, stop, timeout, [&] { return over_ || holds(); });
  return holds();
}

void Supervisor::wait_for_events() {
  std::vector<zmq_pollitem_t> items{{heartbeats_.zmq_socket(), 0, ZMQ_POLLIN, 0},
                                    {nullptr, wake_.get(), ZMQ_POLLIN, 0}};
  const auto watch = [&](const Life& life) {
    if (!life.child) return;
    items.push_back({nullptr, life.child->exit_fd(), ZMQ_POLLIN, 0});
    if (life.child->output_fd() >= 0) items.push_back({nullptr, life.child->output_fd(), ZMQ_POLLIN, 0});
  };
  for (const Process& process : processes_) {
    watch(*process.life);
    if (process.beside) watch(*process.beside->life);
  }
  zmq_poll(items.data(), static_cast<int>(items.size()), kPollMs);
  for (Process& process : processes_) {
    pass_output(process, false);
    pass_beside_output(process, false);
  }
}

void Supervisor::pass_output(Process& process, bool rest) {
  Life& life = *process.life;
  if (!life.child) return;
  for (std::string& line : life.child->read_lines(rest)) {
    if (says_why(line)) life.last_line = line;
    output_({process.name, std::move(line), {}});
  }
}

void Supervisor::pass_beside_output(Process& process, bool rest) {
  if (!process.beside || !process.beside->life->child) return;
  Beside& beside = *process.beside;
  for (std::string& line : beside.life->child->read_lines(rest)) {
    if (says_why(line)) {
      if (beside.last_lines.size() == kLinesKept) beside.last_lines.erase(beside.last_lines.begin());
      beside.last_lines.push_back(line);
    }
    output_({beside.successor ? process.name + ".next" : process.name, std::move(line), {}});
  }
}

void Supervisor::take(const wire::Heartbeat& heartbeat, std::string_view source) {
  const auto [process, life] = sender(source, static_cast<pid_t>(heartbeat.pid()));
  if (process == nullptr) return;
  const bool is_own = life == process->life.get();
  const bool running = heartbeat.state() == wire::ServiceState::Running;
  if (running || !is_own || process->state != ProcessState::Starting) life->last_sign_ns = now_ns_();
  life->service_state = wire::EnumNameServiceState(heartbeat.state());
  life->detail = heartbeat.detail() != nullptr ? heartbeat.detail()->str() : "";
  life->counters.clear();
  if (heartbeat.counters() != nullptr) {
    for (const auto* counter : *heartbeat.counters()) life->counters[counter->name()->str()] = counter->value();
  }
  if (running && is_own && process->state == ProcessState::Starting && !life->plan.readiness) ready(*process);
}

/// By name, since another machine's process may have the same id; and by id, since the broker also hands out the last
/// heartbeat of those that are gone. The broker's name on the bus is its own, whatever the launch file calls it.
std::pair<Supervisor::Process*, Supervisor::Life*> Supervisor::sender(std::string_view source, pid_t pid) {
  const auto is = [&](const Process& process, const Life& life) {
    if (!life.child || life.child->pid() != pid) return false;
    const std::string_view name = life.plan.broker ? kBrokerSource : std::string_view(process.name);
    return source == name || (source.starts_with(name) && source.substr(name.size()) == ".next");
  };
  for (Process& process : processes_) {
    if (is(process, *process.life)) return {&process, process.life.get()};
    if (process.beside && is(process, *process.beside->life)) return {&process, process.beside->life.get()};
  }
  return {nullptr, nullptr};
}

bool Supervisor::anything_to_do() const {
  return std::any_of(processes_.begin(), processes_.end(), [](const Process& process) {
    return process.state != ProcessState::Ended && process.state != ProcessState::Failed;
  });
}

void Supervisor::note_what_does_not_run() {
  std::vector<std::string> found;
  for (const Process& process : processes_) {
    const ProcessState state = process.state;
    if (state == ProcessState::Running || state == ProcessState::Ended || state == ProcessState::Stopped ||
        state == ProcessState::Stopping) {
      continue;
    }
    const std::string& detail = process.life->detail;
    found.push_back(fmt::format("{}: {}{}{}", process.name, to_string(state), detail.empty() ? "" : ", ", detail));
  }
  const std::scoped_lock lock(mutex_);
  not_running_ = std::move(found);
}

void Supervisor::terminate_in_order(bool kill) {
  const std::int64_t now = now_ns_();
  const auto end = [&](const Process& process, Life& life, bool needed) {
    if (!life.child) return;
    if (kill) {
      life.child->signal_group(SIGKILL);
    } else if (life.terminate_ns == 0) {
      if (needed) return;
      life.terminate_ns = now;
      life.child->signal_group(SIGTERM);
    } else if (now - life.terminate_ns > static_cast<std::int64_t>(life.plan.stop_timeout_s * 1e9)) {
      say(process, "killed", "does not stop, killing it", life.child->pid());
      life.terminate_ns = now;
      life.child->signal_group(SIGKILL);
    }
  };
  for (Process& process : processes_) {
    const bool needed = std::any_of(processes_.begin(), processes_.end(), [&](const Process& other) {
      return other.life->child && std::find(other.after.begin(), other.after.end(), process.name) != other.after.end();
    });
    end(process, *process.life, needed);
    if (process.beside) end(process, *process.beside->life, false);
  }
}

void Supervisor::say(const Process& process, const std::string& event, const std::string& text, pid_t pid,
                     std::optional<ExitStatus> exit, std::optional<double> restart_in_s) const {
  output_({process.name, text, event, pid, exit, restart_in_s});
}

void Supervisor::publish_status() {
  std::vector<ProcessStatus> all;
  for (const Process& process : processes_) {
    const Life& life = *process.life;
    ProcessStatus& status = all.emplace_back();
    status.name = process.name;
    status.service = life.plan.service.empty() ? process.name : life.plan.service;
    status.replica = life.plan.replica;
    status.state = process.state;
    status.pid = life.child ? life.child->pid() : 0;
    status.restarts = process.restarts;
    status.started_ns = life.child ? life.started_ns : 0;
    status.detail = life.detail;
    status.counters = life.counters;
    if (!process.beside) continue;
    const Beside& beside = *process.beside;
    status.beside = BesideStatus{.pid = beside.life->child ? beside.life->child->pid() : 0,
                                 .successor = beside.successor,
                                 .service_state = beside.life->service_state,
                                 .detail = beside.life->detail,
                                 .counters = beside.life->counters,
                                 .exit = beside.exit,
                                 .last_lines = beside.last_lines};
  }
  {
    const std::scoped_lock lock(mutex_);
    published_ = std::move(all);
  }
  changed_.notify_all();
}

}  // namespace splatbus::cli
