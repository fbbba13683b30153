#pragma once

#include <atomic>
#include <deque>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <thread>
#include <vector>

#include "supervisor.h"

namespace splatbus::cli {

/// A folder of our own for a bus, removed with what is in it when this goes.
class PrivateBusFolder {
 public:
  PrivateBusFolder();  ///< throws std::runtime_error
  ~PrivateBusFolder();
  PrivateBusFolder(const PrivateBusFolder&) = delete;
  PrivateBusFolder& operator=(const PrivateBusFolder&) = delete;
  [[nodiscard]] bus::Address address() const;
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

/// A supervisor on a thread of its own, for commands that do something beside the services. What these write goes to a
/// log file, if to any.
class SupervisedRun {
 public:
  /// Starts. `log` may be empty; `pass` is given every line too, by the supervisor's thread.
  SupervisedRun(LaunchPlan plan, const std::filesystem::path& log, std::function<void(const OutputLine&)> pass = {});
  ~SupervisedRun();  ///< stops every process and waits for it
  SupervisedRun(const SupervisedRun&) = delete;
  SupervisedRun& operator=(const SupervisedRun&) = delete;

  [[nodiscard]] std::vector<ProcessStatus> status() const { return supervisor_.status(); }
  [[nodiscard]] bool all_running() const;
  [[nodiscard]] Supervisor& supervisor() { return supervisor_; }

  /// Throws std::runtime_error with its last lines of output once a process has failed for good.
  void check() const;

  void stop();  ///< in order; returns when everything has ended
  void kill() { kill_.request_stop(); }

 private:
  void log_line(const OutputLine& line);

  std::filesystem::path log_path_;
  mutable std::mutex mutex_;
  std::ofstream log_;
  std::map<std::string, std::deque<std::string>> last_lines_;
  const std::function<void(const OutputLine&)> pass_;
  Supervisor supervisor_;
  std::stop_source stop_, kill_;
  std::jthread thread_;
};

/// Turns SIGINT, SIGTERM and SIGHUP into stop requests: the first asks to stop, the second to stop at once. Make one
/// before any other thread starts: threads inherit that these signals are blocked.
class StopSignals {
 public:
  StopSignals();

  [[nodiscard]] std::stop_token stop() const { return stop_.get_token(); }
  [[nodiscard]] std::stop_token kill() const { return kill_.get_token(); }

 private:
  std::stop_source stop_, kill_;
  std::jthread thread_;
};

}  // namespace splatbus::cli
