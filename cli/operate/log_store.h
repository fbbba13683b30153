#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "bus/address.h"
#include "bus/file_descriptor.h"
#include "process_output.h"

namespace splatbus::cli {

/// Where the log files of a bus's processes lie: under XDG_STATE_HOME, else ~/.local/state; empty when there is no
/// home.
[[nodiscard]] std::filesystem::path log_folder(const bus::Address& bus);

/// Writes each process's lines to NAME.log, with their time (UTC), and keeps the last few files of each. A disk that is
/// full costs lines, nothing else. One thread.
class LogStore {
 public:
  /// Throws std::runtime_error when the folder cannot be made.
  explicit LogStore(std::filesystem::path folder, std::size_t file_bytes = std::size_t{8} << 20, std::size_t files = 4);
  ~LogStore();
  LogStore(const LogStore&) = delete;
  LogStore& operator=(const LogStore&) = delete;

  void write(const OutputLine& line);

 private:
  struct Sinks;
  std::filesystem::path folder_;
  std::size_t file_bytes_, files_;
  std::unique_ptr<Sinks> sinks_;
};

struct StoredLine {
  std::string time;  ///< "2026-11-23T03:32:00.123456Z": its order is the time's
  std::string process, text;
  bool event = false;
};

/// What the log files of the processes have from a time on (empty: all), in the order of time; with `tail` >= 0 the
/// last of them only.
[[nodiscard]] std::vector<StoredLine> read_logs(const std::filesystem::path& folder,
                                                const std::vector<std::string>& processes, const std::string& since,
                                                int tail);

/// Names that there are log files of.
[[nodiscard]] std::vector<std::string> logged_processes(const std::filesystem::path& folder);

/// "90s", "10m", "2h", "1d" before now, or a time as StoredLine has it, as such a time. Throws std::runtime_error.
[[nodiscard]] std::string since_time(const std::string& text);

/// Log files from now on, of those processes that are wanted: across rotations, and of processes that come later too.
/// One thread.
class LogFollower {
 public:
  using Wanted = std::function<bool(const std::string& process)>;

  /// "From now on" is this call. Throws std::runtime_error when the folder cannot be watched.
  LogFollower(std::filesystem::path folder, Wanted wanted);
  ~LogFollower();
  LogFollower(const LogFollower&) = delete;
  LogFollower& operator=(const LogFollower&) = delete;

  /// As read_logs(): what was there before. Together with run() no line is missing, and none is there twice.
  [[nodiscard]] std::vector<StoredLine> before(const std::string& since, int tail) const;
  /// Passes on what is appended, until `end_fd` is readable or hung up.
  void run(int end_fd, const std::function<void(const StoredLine&)>& pass);

 private:
  class Tail;
  void find_new_ones();

  std::filesystem::path folder_;
  Wanted wanted_;
  bus::FileDescriptor watch_;
  std::map<std::string, std::unique_ptr<Tail>> tails_;  ///< by process
};

}  // namespace splatbus::cli
