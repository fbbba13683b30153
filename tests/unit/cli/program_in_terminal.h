#pragma once

#include <fcntl.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <pty.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <termios.h>
#include <unistd.h>

#include <string>
#include <vector>

#include "bus/file_descriptor.h"

namespace splatbus::cli {

/// A program under a terminal of 40 rows and 150 columns. The first of `command` is its path.
class ProgramInTerminal {
 public:
  explicit ProgramInTerminal(std::vector<std::string> command) {
    winsize size{.ws_row = 40, .ws_col = 150, .ws_xpixel = 0, .ws_ypixel = 0};
    std::vector<char*> arguments;
    for (std::string& one : command) arguments.push_back(one.data());
    arguments.push_back(nullptr);
    int master = -1;
    pid_ = ::forkpty(&master, nullptr, nullptr, &size);
    if (pid_ == 0) {
      ::setenv("TERM", "xterm", 1);
      const rlimit no_core{};
      ::setrlimit(RLIMIT_CORE, &no_core);
      ::execv(arguments[0], arguments.data());
      ::_exit(127);
    }
    master_ = bus::FileDescriptor(master);
  }
  ~ProgramInTerminal() {
    if (pid_ <= 0) return;
    ::kill(pid_, SIGKILL);
    ::waitpid(pid_, nullptr, 0);
  }
  ProgramInTerminal(const ProgramInTerminal&) = delete;
  ProgramInTerminal& operator=(const ProgramInTerminal&) = delete;

  void type(const std::string& keys) {
    ASSERT_EQ(::write(master_.get(), keys.data(), keys.size()), static_cast<ssize_t>(keys.size()));
  }
  void send(int signal) const { ASSERT_EQ(::kill(pid_, signal), 0); }
  /// Whether what is typed there comes in lines and is shown, as terminals are for a shell.
  [[nodiscard]] bool is_as_it_was() const {
    termios modes{};
    EXPECT_EQ(::tcgetattr(master_.get(), &modes), 0);
    return (modes.c_lflag & (ICANON | ECHO)) == (ICANON | ECHO);
  }

  /// Reads until all that came since the last call has `text`; false at the end, or after a minute without output.
  bool read_until(const std::string& text) {
    for (std::string fresh; fresh.find(text) == std::string::npos;) {
      pollfd item{.fd = master_.get(), .events = POLLIN, .revents = 0};
      char buffer[4096];
      if (::poll(&item, 1, 60'000) <= 0) return false;
      const ssize_t bytes = ::read(master_.get(), buffer, sizeof buffer);
      if (bytes <= 0) return false;  // EIO once the program has ended
      fresh.append(buffer, static_cast<std::size_t>(bytes));
      all_.append(buffer, static_cast<std::size_t>(bytes));
    }
    return true;
  }

  /// Its exit status, or the negative signal.
  int wait() {
    int status = 0;
    ::waitpid(pid_, &status, 0);
    pid_ = -1;
    return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
  }
  [[nodiscard]] const std::string& all() const { return all_; }

 private:
  pid_t pid_ = -1;
  bus::FileDescriptor master_;
  std::string all_;
};

}  // namespace splatbus::cli
