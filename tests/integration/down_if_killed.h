#pragma once

#include <fcntl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <stdexcept>
#include <string>

#include "bus/file_descriptor.h"

namespace splatbus::cli {

/// Says `down` to a bus should this program be killed before it does: what `up -d` started is in a session of its own,
/// and would stay. Waits in a process that no longer descends from this one, for a test driver kills all that do.
class DownIfKilled {
 public:
  explicit DownIfKilled(const std::string& bus) {
    std::array<int, 2> ends{};
    if (::pipe2(ends.data(), O_CLOEXEC) != 0) throw std::runtime_error("pipe");
    const bus::FileDescriptor read_end(ends[0]);
    write_end_ = bus::FileDescriptor(ends[1]);
    const std::string program = std::string(SPLATBUS_BIN_DIR) + "/splatbus";
    const pid_t between = ::fork();
    if (between < 0) throw std::runtime_error("fork");
    if (between > 0) {
      ::waitpid(between, nullptr, 0);
      return;
    }
    // Only what is safe between fork and exec.
    if (::fork() != 0) ::_exit(0);
    ::setsid();
    ::close(ends[1]);
    const int nowhere = ::open("/dev/null", O_RDWR);
    for (const int stream : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO}) ::dup2(nowhere, stream);
    char word = 0;
    if (::read(ends[0], &word, 1) != 0) ::_exit(0);
    ::execl(program.c_str(), program.c_str(), "down", "--bus", bus.c_str(), nullptr);
    ::_exit(127);
  }
  ~DownIfKilled() { (void)!::write(write_end_.get(), "", 1); }
  DownIfKilled(const DownIfKilled&) = delete;
  DownIfKilled& operator=(const DownIfKilled&) = delete;

 private:
  bus::FileDescriptor write_end_;
};

}  // namespace splatbus::cli
