#include "child_process.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <stdexcept>
#include <string>

namespace splatbus::cli {
namespace {

constexpr int kPatienceMs = 20000;

ExitStatus wait_for_exit(ChildProcess& child) {
  pollfd exit{.fd = child.exit_fd(), .events = POLLIN, .revents = 0};
  EXPECT_EQ(poll(&exit, 1, kPatienceMs), 1);
  const auto status = child.poll_exit();
  EXPECT_TRUE(status.has_value());
  return status.value_or(ExitStatus{});
}

/// Lines until there is one, without waiting for the end.
std::string wait_for_line(ChildProcess& child) {
  for (;;) {
    pollfd output{.fd = child.output_fd(), .events = POLLIN, .revents = 0};
    if (poll(&output, 1, kPatienceMs) != 1) return "nothing came";
    const auto lines = child.read_lines(false);
    if (!lines.empty()) return lines.front();
  }
}

ChildProcess shell(const std::string& script, const std::map<std::string, std::string>& environment = {}) {
  return {"/bin/sh", {"-c", script}, environment};
}

TEST(ChildProcess, OutputOfBothStreamsAndStatus) {
  ChildProcess child = shell("echo one; echo two >&2; printf three; exit 3");
  const ExitStatus status = wait_for_exit(child);
  EXPECT_EQ(status.code, 3);
  EXPECT_EQ(status.text(), "exited with status 3");
  EXPECT_FALSE(status.success());
  EXPECT_THAT(child.read_lines(true), testing::ElementsAre("one", "two", "three"));
}

TEST(ChildProcess, EnvironmentIsAddedToOurs) {
  setenv("SPLATBUS_TEST_KEPT", "kept", 1);
  setenv("SPLATBUS_TEST_OLD", "old", 1);
  ChildProcess child = shell("echo $SPLATBUS_TEST_KEPT $SPLATBUS_TEST_OLD", {{"SPLATBUS_TEST_OLD", "new"}});
  wait_for_exit(child);
  EXPECT_THAT(child.read_lines(true), testing::ElementsAre("kept new"));
}

TEST(ChildProcess, StandsBackAsFarAsItIsToldTo) {
  ChildProcess child("/bin/sh", {"-c", "nice"}, {}, 7);
  wait_for_exit(child);
  const int most = std::min(getpriority(PRIO_PROCESS, 0) + 7, 19);
  EXPECT_THAT(child.read_lines(true), testing::ElementsAre(std::to_string(most)));
}

TEST(ChildProcess, ProgramThatIsNotThereIsNamed) {
  try {
    const ChildProcess child("/nonexistent/program", {}, {});
    FAIL();
  } catch (const std::runtime_error& error) {
    EXPECT_STREQ(error.what(), "cannot start /nonexistent/program: No such file or directory");
  }
}

TEST(ChildProcess, SignalIsReported) {
  ChildProcess child = shell("echo ready; exec sleep 100");
  EXPECT_EQ(wait_for_line(child), "ready");
  EXPECT_FALSE(child.poll_exit().has_value());
  child.signal_group(SIGKILL);
  EXPECT_EQ(wait_for_exit(child).text(), "killed by signal 9 (Killed)");
}

TEST(ChildProcess, SignalsAreNotBlockedInIt) {
  sigset_t term, before;
  sigemptyset(&term);
  sigaddset(&term, SIGTERM);
  pthread_sigmask(SIG_BLOCK, &term, &before);
  ChildProcess child = shell("echo ready; exec sleep 100");
  pthread_sigmask(SIG_SETMASK, &before, nullptr);
  EXPECT_EQ(wait_for_line(child), "ready");
  child.signal_group(SIGTERM);
  EXPECT_EQ(wait_for_exit(child).signal, SIGTERM);
}

bool is_alive(pid_t pid) {
  return kill(pid, 0) == 0;
}

TEST(ChildProcess, GrandchildrenGoWithIt) {
  ChildProcess child = shell("sleep 100 & echo $!; exit 0");
  const pid_t grandchild = std::stoi(wait_for_line(child));
  wait_for_exit(child);
  // Its new parent may take a moment to collect it: a killed process stays visible until then.
  std::string state;
  for (int attempt = 0; attempt < kPatienceMs / 10 && is_alive(grandchild) && state != "Z"; ++attempt) {
    ChildProcess look = shell("cut -d' ' -f3 /proc/" + std::to_string(grandchild) + "/stat 2>/dev/null || echo Z");
    wait_for_exit(look);
    const auto lines = look.read_lines(true);
    state = lines.empty() ? "Z" : lines.front();
  }
  EXPECT_TRUE(!is_alive(grandchild) || state == "Z");
}

TEST(ChildProcess, DestructorLeavesNothing) {
  pid_t pid = 0;
  {
    ChildProcess child = shell("trap '' TERM; echo ready; while :; do sleep 1; done");
    EXPECT_EQ(wait_for_line(child), "ready");
    pid = child.pid();
    EXPECT_TRUE(is_alive(pid));
  }
  EXPECT_FALSE(is_alive(pid));
}

TEST(ChildProcess, EndlessLineIsCut) {
  ChildProcess child = shell("head -c 3000000 /dev/zero | tr '\\0' x");
  std::size_t total = 0;
  while (child.output_fd() >= 0) {
    pollfd output{.fd = child.output_fd(), .events = POLLIN, .revents = 0};
    ASSERT_EQ(poll(&output, 1, kPatienceMs), 1);
    for (const std::string& line : child.read_lines(true)) {
      EXPECT_LE(line.size(), 1U << 20);
      total += line.size();
    }
  }
  EXPECT_EQ(total, 3000000U);
}

}  // namespace
}  // namespace splatbus::cli
