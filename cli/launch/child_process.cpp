#include "child_process.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <linux/close_range.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cassert>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "bus/permanent_error.h"

namespace splatbus::cli {

namespace {

constexpr std::size_t kLongestLine = std::size_t{1} << 20;

std::vector<char*> pointers(std::vector<std::string>& strings) {
  std::vector<char*> result;
  result.reserve(strings.size() + 1);
  for (std::string& s : strings) result.push_back(s.data());
  result.push_back(nullptr);
  return result;
}

std::vector<std::string> merged_environment(const std::map<std::string, std::string>& added) {
  std::vector<std::string> result;
  for (char** variable = environ; *variable != nullptr; ++variable) {
    const std::string_view text = *variable;
    if (!added.contains(std::string(text.substr(0, text.find('='))))) result.emplace_back(text);
  }
  for (const auto& [key, value] : added) {
    std::string variable = key;
    result.push_back(variable.append("=").append(value));
  }
  return result;
}

/// glibc 2.36 declares pidfd_open without extern "C".
int open_pidfd(pid_t pid) {
  return static_cast<int>(syscall(SYS_pidfd_open, pid, 0));
}

[[noreturn]] void throw_cannot(const std::string& what, int error) {
  const std::string text = fmt::format("cannot {}: {}", what, std::strerror(error));
  if (error == EAGAIN || error == ENOMEM || error == EMFILE || error == ENFILE) throw StartedTooSoon(text);
  throw std::runtime_error(text);
}

struct Pipe {
  bus::FileDescriptor read, write;
};

Pipe make_pipe(int flags) {
  std::array<int, 2> fds{};
  if (pipe2(fds.data(), flags) != 0) throw_cannot("make a pipe", errno);
  return {bus::FileDescriptor(fds[0]), bus::FileDescriptor(fds[1])};
}

/// Runs in the child between fork and exec: async-signal-safe calls only.
[[noreturn]] void become(char** argv, char** envp, int output, int failure, pid_t parent, int nice) {
  setpgid(0, 0);
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (getppid() != parent) _exit(127);
  // What asks for less may always have it.
  if (nice > 0) setpriority(PRIO_PROCESS, 0, std::min(getpriority(PRIO_PROCESS, 0) + nice, 19));
  sigset_t none;
  sigemptyset(&none);
  sigprocmask(SIG_SETMASK, &none, nullptr);
  for (const int signal : {SIGINT, SIGTERM, SIGHUP, SIGPIPE, SIGCHLD, SIGQUIT}) ::signal(signal, SIG_DFL);
  const int null = open("/dev/null", O_RDONLY);
  if (null >= 0 && dup2(null, STDIN_FILENO) >= 0 && dup2(output, STDOUT_FILENO) >= 0 &&
      dup2(output, STDERR_FILENO) >= 0) {
    close_range(3, ~0U, CLOSE_RANGE_CLOEXEC);
    execve(argv[0], argv, envp);
  }
  const int error = errno;
  [[maybe_unused]] const auto written = write(failure, &error, sizeof error);
  _exit(127);
}

}  // namespace

bool ExitStatus::permanent() const {
  return signal == 0 && (code == bus::kExitPermanent || code == 2);
}

std::string ExitStatus::text() const {
  if (signal != 0) return fmt::format("killed by signal {} ({})", signal, strsignal(signal));
  if (const int stopped_by = code - 128; stopped_by > 0 && stopped_by < NSIG) {
    return fmt::format("stopped by signal {} ({})", stopped_by, strsignal(stopped_by));
  }
  return fmt::format("exited with status {}", code);
}

ChildProcess::ChildProcess(const std::filesystem::path& program, const std::vector<std::string>& arguments,
                           const std::map<std::string, std::string>& environment, int nice) {
  std::vector<std::string> arg_strings{program.string()};
  arg_strings.insert(arg_strings.end(), arguments.begin(), arguments.end());
  std::vector<std::string> env_strings = merged_environment(environment);
  const std::vector<char*> argv = pointers(arg_strings);
  const std::vector<char*> envp = pointers(env_strings);
  Pipe output = make_pipe(O_CLOEXEC);
  Pipe failure = make_pipe(O_CLOEXEC);

  const pid_t parent = getpid();
  pid_ = fork();
  if (pid_ < 0) throw_cannot("start " + program.string(), errno);
  if (pid_ == 0) {
    become(const_cast<char**>(argv.data()), const_cast<char**>(envp.data()), output.write.get(), failure.write.get(),
           parent, nice);
  }
  setpgid(pid_, pid_);
  output.write.reset();
  failure.write.reset();
  int error = 0;
  ssize_t got = 0;
  do {
    got = read(failure.read.get(), &error, sizeof error);
  } while (got < 0 && errno == EINTR);
  if (got > 0) {
    waitpid(pid_, nullptr, 0);
    throw_cannot("start " + program.string(), error);
  }
  exit_ = bus::FileDescriptor(open_pidfd(pid_));
  if (exit_.get() < 0) {
    const int reason = errno;
    signal_group(SIGKILL);
    waitpid(pid_, nullptr, 0);
    throw_cannot("watch " + program.string(), reason);
  }
  output_ = std::move(output.read);
  fcntl(output_.get(), F_SETFL, O_NONBLOCK);
}

ChildProcess::~ChildProcess() {
  if (exit_.get() < 0 || ended_) return;  // moved from, or gone already
  signal_group(SIGKILL);
  waitpid(pid_, nullptr, 0);
}

std::vector<std::string> ChildProcess::read_lines(bool rest) {
  std::array<char, 8192> chunk{};
  while (output_.get() >= 0 && partial_.size() < 4 * kLongestLine) {
    const ssize_t got = read(output_.get(), chunk.data(), chunk.size());
    if (got > 0) {
      partial_.append(chunk.data(), static_cast<std::size_t>(got));
    } else if (got < 0 && errno == EINTR) {
      continue;
    } else {
      if (got == 0) output_.reset();
      break;
    }
  }
  std::vector<std::string> lines;
  std::size_t begin = 0;
  for (;;) {
    const std::size_t end = partial_.find('\n', begin);
    if (end != std::string::npos) {
      lines.push_back(partial_.substr(begin, end - begin));
      begin = end + 1;
    } else if (partial_.size() - begin > kLongestLine || (rest && begin < partial_.size())) {
      lines.push_back(partial_.substr(begin, kLongestLine));
      begin += lines.back().size();
    } else {
      break;
    }
  }
  partial_.erase(0, begin);
  return lines;
}

void ChildProcess::signal_group(int signal) const {
  if (ended_) return;
  // The group may not exist yet when the child was started a moment ago, nor any more while it is being reaped.
  if (kill(-pid_, signal) != 0) kill(pid_, signal);
}

std::optional<ExitStatus> ChildProcess::poll_exit() {
  if (ended_) return ended_;
  siginfo_t info{};
  // Not reaped yet, so that the group's number cannot belong to somebody else when its rest is killed.
  if (waitid(P_PID, static_cast<id_t>(pid_), &info, WEXITED | WNOHANG | WNOWAIT) != 0 || info.si_pid == 0) return {};
  kill(-pid_, SIGKILL);
  waitpid(pid_, nullptr, 0);
  if (info.si_code == CLD_EXITED) {
    ended_ = ExitStatus{.code = info.si_status, .signal = 0};
  } else {
    ended_ = ExitStatus{.code = 0, .signal = info.si_status};
  }
  return ended_;
}

}  // namespace splatbus::cli
