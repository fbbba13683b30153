// What an operator asks for, obeyed between two rounds of the supervisor's loop.
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <sys/eventfd.h>

#include <algorithm>
#include <csignal>
#include <future>
#include <stdexcept>
#include <utility>

#include "supervisor.h"

namespace splatbus::cli {

namespace {

[[noreturn]] void throw_over() {
  throw std::runtime_error("the supervisor is stopping everything");
}

}  // namespace

void Supervisor::order(std::function<void()> work) {
  auto task = std::make_shared<std::packaged_task<void()>>([this, work = std::move(work)] {
    work();
    publish_status();
  });
  auto done = task->get_future();
  {
    const std::scoped_lock lock(mutex_);
    if (over_) throw_over();
    orders_.emplace_back([task = std::move(task)] { (*task)(); });
  }
  eventfd_write(wake_.get(), 1);
  try {
    done.get();
  } catch (const std::future_error&) {  // never obeyed
    throw_over();
  }
}

void Supervisor::obey_orders() {
  eventfd_t count = 0;
  eventfd_read(wake_.get(), &count);
  std::vector<std::function<void()>> orders;
  {
    const std::scoped_lock lock(mutex_);
    orders.swap(orders_);
  }
  for (const auto& obey : orders) obey();
}

void Supervisor::refuse_orders() {
  std::vector<std::function<void()>> orders;
  {
    const std::scoped_lock lock(mutex_);
    over_ = true;
    orders.swap(orders_);
  }
  changed_.notify_all();
}

ProcessPlan Supervisor::plan_of(const std::string& name) {
  ProcessPlan plan;
  order([&] { plan = find(name).life->plan; });
  return plan;
}

void Supervisor::change_plan(const std::string& name, const std::function<void(ProcessPlan&)>& change) {
  order([&] { change(find_not_swapped(name).life->plan); });
}

Supervisor::Process& Supervisor::find(const std::string& name) {
  std::vector<std::string> names;
  for (Process& process : processes_) {
    if (process.name == name) return process;
    names.push_back(process.name);
  }
  throw std::runtime_error(fmt::format("there is no process '{}' (there are: {})", name, fmt::join(names, ", ")));
}

Supervisor::Process& Supervisor::find_not_swapped(const std::string& name) {
  Process& process = find(name);
  if (process.is_swapped()) throw std::runtime_error(fmt::format("'{}' is being swapped", name));
  return process;
}

void Supervisor::forget_failure(const Process& process) {
  const std::scoped_lock lock(mutex_);
  std::erase_if(failures_, [&](const auto& failure) { return failure.first == process.name; });
}

void Supervisor::stop_for(Process& process, AtEnd at_end) {
  process.at_end = at_end;
  if (process.state == ProcessState::Stopping) return;
  process.state = ProcessState::Stopping;
  say(process, "stopping", "stopping", process.life->child->pid());
  process.life->terminate_ns = now_ns_();
  process.life->child->signal_group(SIGTERM);
}

void Supervisor::start(const std::string& name) {
  order([this, name] {
    Process& process = find_not_swapped(name);
    if (process.state == ProcessState::Stopping) {
      process.at_end = AtEnd::StartAgain;
      return;
    }
    if (process.life->child || process.state == ProcessState::Waiting) return;
    process.attempts = 0;
    forget_failure(process);
    process.state = ProcessState::Waiting;  // started in this round's turn, after those that it waits for
  });
}

void Supervisor::stop(const std::string& name) {
  order([this, name] {
    Process& process = find_not_swapped(name);
    forget_failure(process);
    if (process.life->child) return stop_for(process, AtEnd::StayStopped);
    process.state = ProcessState::Stopped;
    process.life->detail.clear();
  });
}

void Supervisor::restart(const std::string& name) {
  order([this, name] {
    Process& process = find_not_swapped(name);
    process.attempts = 0;
    forget_failure(process);
    if (process.life->child) return stop_for(process, AtEnd::StartAgain);
    process.state = ProcessState::Waiting;
  });
}

void Supervisor::add(ProcessPlan plan, std::vector<std::string> after) {
  order([this, &plan, &after] {
    for (const Process& process : processes_) {
      if (process.name == plan.name)
        throw std::runtime_error(fmt::format("there is a process '{}' already", plan.name));
    }
    Process& process = processes_.emplace_back();
    process.name = plan.name;
    process.after = std::move(after);
    process.life->plan = std::move(plan);
  });
}

void Supervisor::remove(const std::string& name) {
  order([this, name] {
    Process& process = find_not_swapped(name);
    forget_failure(process);
    if (process.life->child) return stop_for(process, AtEnd::Forget);
    processes_.remove_if([&](const Process& other) { return &other == &process; });
  });
}

void Supervisor::start_successor(const std::string& name, ProcessPlan plan) {
  order([this, name, &plan] {
    Process& process = find(name);
    if (process.beside) throw std::runtime_error(fmt::format("'{}' has another process beside it already", name));
    auto beside = std::make_unique<Beside>();
    beside->life->plan = std::move(plan);
    start_child(*beside->life);
    process.beside = std::move(beside);
    const pid_t pid = process.beside->life->child->pid();
    say(process, "started", fmt::format("started a successor, process {}", pid), pid);
  });
}

void Supervisor::exchange(const std::string& name, double leave_within_s) {
  order([this, name, leave_within_s] {
    Process& process = find(name);
    if (!process.beside || !process.beside->life->child) {
      throw std::runtime_error(fmt::format("'{}' has no process beside it", name));
    }
    Beside& beside = *process.beside;
    std::swap(process.life, beside.life);
    beside.life->stop_probes();
    beside.successor = !beside.successor;
    std::erase(process.life->plan.arguments, "--successor");  // started again, it is none
    beside.exit.reset();
    beside.last_lines.clear();
    beside.forget = true;
    const std::int64_t now = now_ns_();
    beside.leave_by_ns = now + static_cast<std::int64_t>(leave_within_s * 1e9);
    Life& life = *process.life;
    life.last_sign_ns = now;
    process.at_end = AtEnd::Policy;
    process.attempts = 0;
    process.held.reset();
    forget_failure(process);
    process.state = ProcessState::Running;
    process.was_ready = true;
    life.ready_ns = now;
    say(process, "ready", fmt::format("now process {}", life.child->pid()), life.child->pid());
    if (!beside.life->child) process.beside.reset();  // it died before
  });
}

void Supervisor::drop_beside(const std::string& name) {
  order([this, name] {
    Process& process = find(name);
    if (!process.beside) return;
    Beside& beside = *process.beside;
    beside.forget = true;
    beside.leave_by_ns = now_ns_();
    if (!beside.life->child) process.beside.reset();
    if (const auto held = std::exchange(process.held, std::nullopt)) ended(process, *held);
  });
}

void Supervisor::reap_beside(Process& process) {
  if (!process.beside || !process.beside->life->child) return;
  Beside& beside = *process.beside;
  const auto exit = beside.life->child->poll_exit();
  if (!exit) return;
  pass_beside_output(process, true);
  beside.life->child.reset();
  beside.exit = exit;
  say(process, "ended", fmt::format("{}: {}", beside.successor ? "successor" : "predecessor", exit->text()), 0, exit);
  if (beside.forget) process.beside.reset();
}

}  // namespace splatbus::cli
