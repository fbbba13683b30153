#pragma once

#include <fcntl.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <stdexcept>
#include <string>
#include <vector>

#include "bus_fixture.h"

namespace splatbus::bus_test {

/// A program from the build's bin folder, killed at the end if it still runs. Its output goes to a file.
class ChildProcess {
 public:
  ChildProcess(const std::string& program, std::vector<std::string> arguments, const std::string& output_path) {
    const std::string path = std::string(SPLATBUS_BIN_DIR) + "/" + program;
    arguments.insert(arguments.begin(), path);
    std::vector<char*> argv;
    argv.reserve(arguments.size() + 1);
    for (auto& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);
    pid_ = ::fork();
    if (pid_ < 0) throw std::runtime_error("fork");
    if (pid_ > 0) return;
    // Only what is safe between fork and exec.
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    const int output = ::open(output_path.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
    ::dup2(output, STDOUT_FILENO);
    ::dup2(output, STDERR_FILENO);
    ::execv(path.c_str(), argv.data());
    ::_exit(127);
  }
  ~ChildProcess() {
    if (pid_ > 0) {
      send(SIGKILL);
      wait();
    }
  }
  ChildProcess(const ChildProcess&) = delete;
  ChildProcess& operator=(const ChildProcess&) = delete;

  void send(int signal) const { ::kill(pid_, signal); }

  /// Exit status, or minus the signal that ended it; kills it when it does not end in time.
  int wait() {
    int status = 0;
    if (!eventually([&] { return ::waitpid(pid_, &status, WNOHANG) == pid_; })) {
      send(SIGKILL);
      ::waitpid(pid_, &status, 0);
    }
    pid_ = -1;
    return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
  }

  [[nodiscard]] int pid() const { return pid_; }

 private:
  int pid_ = -1;
};

/// All of a file.
inline std::string read_text(const std::string& path) {
  std::string text;
  const int file = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  char buffer[4096];
  for (ssize_t n = 0; file >= 0 && (n = ::read(file, buffer, sizeof(buffer))) > 0;) text.append(buffer, n);
  if (file >= 0) ::close(file);
  return text;
}

}  // namespace splatbus::bus_test
