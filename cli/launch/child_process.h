#pragma once

#include <sys/types.h>

#include <filesystem>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "bus/file_descriptor.h"

namespace splatbus::cli {

/// How a process ended.
struct ExitStatus {
  int code = 0;  ///< when signal is 0
  int signal = 0;

  [[nodiscard]] bool success() const { return code == 0 && signal == 0; }
  /// Said by a program that would only fail again: bus::kExitPermanent, or 2 for a command line that it refuses.
  [[nodiscard]] bool permanent() const;
  /// "exited with status 3", "killed by signal 9 (Killed)"; of 128 + a signal, "stopped by signal 15 (Terminated)".
  [[nodiscard]] std::string text() const;
};

/// A process that could not be started for want of memory, descriptors or processes: later it may be.
class StartedTooSoon : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// A child in a process group of its own, which dies with us: when the thread that started it ends (PR_SET_PDEATHSIG),
/// or when this object does. Its standard input is empty; standard output and error come through one pipe. Not
/// thread-safe; start it on a thread that lives as long as it shall.
class ChildProcess {
 public:
  /// `nice`, 0 to 19, is added to ours (nice(2)). Throws std::runtime_error that names the program when it cannot be
  /// started, StartedTooSoon where that may pass.
  ChildProcess(const std::filesystem::path& program, const std::vector<std::string>& arguments,
               const std::map<std::string, std::string>& environment, int nice = 0);
  ~ChildProcess();
  ChildProcess(ChildProcess&&) noexcept = default;
  ChildProcess& operator=(ChildProcess&&) = delete;

  [[nodiscard]] pid_t pid() const { return pid_; }
  [[nodiscard]] int exit_fd() const { return exit_.get(); }      ///< readable when it has ended
  [[nodiscard]] int output_fd() const { return output_.get(); }  ///< -1 once it is closed

  /// Whole lines that have arrived; with `rest`, also what a last line without an end has.
  [[nodiscard]] std::vector<std::string> read_lines(bool rest);

  void signal_group(int signal) const;

  /// How it ended, or nullopt while it runs. What is left of its process group is killed.
  [[nodiscard]] std::optional<ExitStatus> poll_exit();

 private:
  pid_t pid_ = -1;
  bus::FileDescriptor exit_, output_;
  std::string partial_;
  std::optional<ExitStatus> ended_;
};

}  // namespace splatbus::cli
