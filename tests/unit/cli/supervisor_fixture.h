#pragma once

#include <gtest/gtest.h>
#include <stdlib.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <filesystem>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "bus/broker.h"
#include "bus/clock.h"
#include "supervisor.h"

namespace splatbus::cli {

using namespace std::chrono_literals;

inline constexpr auto kPatience = 60s;

inline ProcessPlan shell(const std::string& name, const std::string& script, std::vector<std::size_t> after = {}) {
  ProcessPlan plan;
  plan.name = name;
  plan.program = "/bin/sh";
  plan.arguments = {"-c", script};
  plan.after = std::move(after);
  plan.heartbeat_timeout_s = 0;
  return plan;
}

/// Runs a plan on a thread, on a bus with an in-process broker, and remembers what was said.
class SupervisorTest : public testing::Test {
 protected:
  SupervisorTest() {
    std::string path = (std::filesystem::temp_directory_path() / "splatbus-supervisor-XXXXXX").string();
    folder_ = mkdtemp(path.data());
    broker_.emplace(bus_service::BrokerOptions{.address = bus::Address::parse("ipc://" + folder_)});
    broker_->start();
  }
  ~SupervisorTest() override {
    stop();
    supervisor_.reset();
    broker_.reset();
    std::filesystem::remove_all(folder_);
  }

  void launch(std::vector<ProcessPlan> processes) {
    LaunchPlan plan{bus::Address::parse("ipc://" + folder_), std::move(processes)};
    supervisor_.emplace(
        plan,
        [this](const OutputLine& line) {
          const std::scoped_lock lock(mutex_);
          lines_.push_back(line.process + (line.event.empty() ? " | " : " * ") + line.text);
          changed_.notify_all();
        },
        [this] {
          ++clock_reads_;
          return clock_stopped_ ? stopped_at_ns_.load() : bus::now_ns();
        });
    thread_ = std::jthread([this] { success_ = supervisor_->run(stop_.get_token(), kill_.get_token()); });
  }

  void stop() {
    stop_.request_stop();
    wait_for_end();
  }
  void wait_for_end() {
    if (thread_.joinable()) thread_.join();
  }

  [[nodiscard]] bool wait_for_line(const std::string& text, std::size_t times = 1) {
    std::unique_lock lock(mutex_);
    return changed_.wait_for(lock, kPatience, [&] {
      return static_cast<std::size_t>(std::count_if(lines_.begin(), lines_.end(), [&](const std::string& line) {
               return line.find(text) != std::string::npos;
             })) >= times;
    });
  }

  [[nodiscard]] std::vector<std::string> lines() {
    const std::scoped_lock lock(mutex_);
    return lines_;
  }

  [[nodiscard]] ProcessStatus status(const std::string& name) const {
    for (const ProcessStatus& status : supervisor_->status()) {
      if (status.name == name) return status;
    }
    return {};
  }

  [[nodiscard]] bool wait_for_state(const std::string& name, ProcessState state) const {
    const auto end = std::chrono::steady_clock::now() + kPatience;
    while (status(name).state != state) {
      if (std::chrono::steady_clock::now() > end) return false;
      std::this_thread::yield();
    }
    return true;
  }

  /// The supervisor's clock stands still, but for pass(). Before launch().
  void stop_clock() {
    stopped_at_ns_ = bus::now_ns();
    clock_stopped_ = true;
  }
  /// Moves a clock that was stopped, and returns when the supervisor has judged everything by the new time.
  void pass(double seconds) {
    stopped_at_ns_ += static_cast<std::int64_t>(seconds * 1e9);
    constexpr std::uint64_t kReadsInTwoRounds = 6;  // at least two are in each
    const std::uint64_t enough = clock_reads_ + kReadsInTwoRounds;
    while (clock_reads_ < enough) std::this_thread::yield();
  }

  std::string folder_;
  std::optional<bus_service::Broker> broker_;
  std::atomic<bool> clock_stopped_ = false;
  std::atomic<std::int64_t> stopped_at_ns_ = 0;
  std::atomic<std::uint64_t> clock_reads_ = 0;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<std::string> lines_;
  std::optional<Supervisor> supervisor_;
  std::stop_source stop_, kill_;
  std::atomic<bool> success_ = false;
  std::jthread thread_;
};

}  // namespace splatbus::cli
