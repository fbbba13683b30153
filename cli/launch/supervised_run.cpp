#include "supervised_run.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <stdexcept>
#include <utility>

namespace splatbus::cli {

PrivateBusFolder::PrivateBusFolder() {
  std::string path = (std::filesystem::temp_directory_path() / "splatbus-run-XXXXXX").string();
  if (mkdtemp(path.data()) == nullptr) {
    throw std::runtime_error(fmt::format("cannot make a folder for the bus in {}: {}",
                                         std::filesystem::temp_directory_path().string(), std::strerror(errno)));
  }
  path_ = path;
}

PrivateBusFolder::~PrivateBusFolder() {
  std::error_code ignored;
  std::filesystem::remove_all(path_, ignored);
}

bus::Address PrivateBusFolder::address() const {
  return bus::Address::parse("ipc://" + path_.string());
}

SupervisedRun::SupervisedRun(LaunchPlan plan, const std::filesystem::path& log,
                             std::function<void(const OutputLine&)> pass)
    : log_path_(log),
      log_(log),
      pass_(std::move(pass)),
      supervisor_(std::move(plan), [this](const OutputLine& line) { log_line(line); }),
      thread_([this] { supervisor_.run(stop_.get_token(), kill_.get_token()); }) {}

SupervisedRun::~SupervisedRun() {
  stop();
}

bool SupervisedRun::all_running() const {
  const auto processes = status();
  return std::all_of(processes.begin(), processes.end(),
                     [](const ProcessStatus& p) { return p.state == ProcessState::Running; });
}

void SupervisedRun::check() const {
  const auto failure = supervisor_.failure();
  if (!failure) return;
  const std::string name = failure->substr(0, failure->find(':'));
  std::string text = *failure;
  if (!log_path_.empty()) text += fmt::format(" (all output: {})", log_path_.string());
  const std::scoped_lock lock(mutex_);
  if (const auto lines = last_lines_.find(name); lines != last_lines_.end()) {
    for (const std::string& line : lines->second) text += "\n  " + line;
  }
  throw std::runtime_error(text);
}

void SupervisedRun::stop() {
  stop_.request_stop();
  if (thread_.joinable()) thread_.join();
}

void SupervisedRun::log_line(const OutputLine& line) {
  if (pass_) pass_(line);
  const std::scoped_lock lock(mutex_);
  log_ << line.process << (line.event.empty() ? " | " : " * ") << line.text << std::endl;
  auto& lines = last_lines_[line.process];
  lines.push_back(line.text);
  if (lines.size() > kLinesKept) lines.pop_front();
}

StopSignals::StopSignals() {
  sigset_t signals;
  sigemptyset(&signals);
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) sigaddset(&signals, signal);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  thread_ = std::jthread([this, signals](const std::stop_token& end) {
    const timespec patience{.tv_sec = 0, .tv_nsec = 100'000'000};
    while (!end.stop_requested()) {
      if (sigtimedwait(&signals, nullptr, &patience) < 0) continue;
      if (!stop_.request_stop()) kill_.request_stop();
    }
  });
}

}  // namespace splatbus::cli
