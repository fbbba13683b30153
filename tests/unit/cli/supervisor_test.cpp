#include "supervisor.h"

#include <gmock/gmock.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <string>
#include <vector>

#include "bus/file_descriptor.h"
#include "supervisor_fixture.h"

namespace splatbus::cli {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

TEST_F(SupervisorTest, EndsWhenAllHaveEnded) {
  launch({shell("a", "echo hello"), shell("b", "exit 0")});
  wait_for_end();
  EXPECT_TRUE(success_);
  EXPECT_THAT(lines(), testing::Contains("a | hello"));
  EXPECT_EQ(status("a").state, ProcessState::Ended);
}

TEST_F(SupervisorTest, RestartsWithBackOffUntilItFailsForGood) {
  launch({shell("a", "exit 7")});
  ASSERT_TRUE(wait_for_line("a * exited with status 7; starting it again in 0.1 s"));
  ASSERT_TRUE(wait_for_line("a * exited with status 7; starting it again in 0.2 s"));
  EXPECT_TRUE(wait_for_line("a * started", 3));
  EXPECT_FALSE(supervisor_->failure().has_value());
}

TEST(BackOff, DoublesUpToEightSeconds) {
  std::vector<double> delays;
  for (int attempts = 1; attempts <= 9; ++attempts) delays.push_back(back_off_s(attempts));
  EXPECT_THAT(delays, ElementsAre(0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 8, 8));
}

TEST_F(SupervisorTest, FailsForGoodAtTheEighthEndInARow) {
  stop_clock();
  launch({shell("a", "exit 7")});
  for (std::size_t attempt = 1; attempt <= 7; ++attempt) {
    ASSERT_TRUE(wait_for_line("starting it again in", attempt)) << attempt;
    pass(8.001);
  }
  ASSERT_TRUE(wait_for_line("a * failed: exited with status 7, 8 times in a row"));
  wait_for_end();
  EXPECT_FALSE(success_);
}

TEST_F(SupervisorTest, ForgetsEarlierEndsAfterTenHealthySeconds) {
  stop_clock();
  launch({shell("a", "exec sleep 100")});
  const auto kill_after = [&](double seconds, const std::string& said, std::size_t lives) {
    ASSERT_TRUE(wait_for_line("a * started", lives));
    ASSERT_TRUE(wait_for_state("a", ProcessState::Running));
    pass(seconds);
    kill(status("a").pid, SIGKILL);
    ASSERT_TRUE(wait_for_line("a * killed by signal 9 (Killed); starting it again in " + said));
    ASSERT_TRUE(wait_for_state("a", ProcessState::BackOff));
    pass(1);
  };
  ASSERT_NO_FATAL_FAILURE(kill_after(0, "0.1 s", 1));
  ASSERT_NO_FATAL_FAILURE(kill_after(9.9, "0.2 s", 2));
  ASSERT_NO_FATAL_FAILURE(kill_after(0, "0.4 s", 3));
  ASSERT_TRUE(wait_for_line("a * started", 4));
  ASSERT_TRUE(wait_for_state("a", ProcessState::Running));
  pass(10.1);
  kill(status("a").pid, SIGKILL);
  EXPECT_TRUE(wait_for_line("a * killed by signal 9 (Killed); starting it again in 0.1 s", 2));
}

TEST_F(SupervisorTest, AProcessIsAsNiceAsItsEntrySays) {
  ProcessPlan plan = shell("a", "nice; exec sleep 100");
  plan.nice = 4;
  launch({plan});
  EXPECT_TRUE(wait_for_line("a | " + std::to_string(std::min(getpriority(PRIO_PROCESS, 0) + 4, 19))));
}

TEST_F(SupervisorTest, NeverMeansNever) {
  ProcessPlan once = shell("a", "exit 7");
  once.restart = RestartPolicy::Never;
  launch({once, shell("b", "exec sleep 100")});
  ASSERT_TRUE(wait_for_line("a * failed: exited with status 7"));
  EXPECT_TRUE(wait_for_state("b", ProcessState::Running)) << "others go on";
  EXPECT_EQ(*supervisor_->failure(), "a: exited with status 7");
  stop();
  EXPECT_FALSE(success_);
}

TEST_F(SupervisorTest, AlwaysStartsAgainAfterSuccess) {
  ProcessPlan again = shell("a", "exit 0");
  again.restart = RestartPolicy::Always;
  launch({again});
  EXPECT_TRUE(wait_for_line("a * started", 3));
}

TEST_F(SupervisorTest, KilledProcessComesBackAndOthersStay) {
  launch({shell("a", "echo up; exec sleep 100"), shell("b", "echo up; exec sleep 100")});
  ASSERT_TRUE(wait_for_line("a | up"));
  ASSERT_TRUE(wait_for_line("b | up"));
  ASSERT_TRUE(wait_for_state("a", ProcessState::Running));
  ASSERT_TRUE(wait_for_state("b", ProcessState::Running));
  const pid_t old_a = status("a").pid;
  const pid_t old_b = status("b").pid;
  kill(old_a, SIGKILL);
  ASSERT_TRUE(wait_for_line("a * killed by signal 9"));
  ASSERT_TRUE(wait_for_line("a | up", 2));
  ASSERT_TRUE(wait_for_state("a", ProcessState::Running));
  EXPECT_NE(status("a").pid, old_a);
  EXPECT_EQ(status("a").restarts, 1);
  EXPECT_EQ(status("b").pid, old_b);
}

TEST_F(SupervisorTest, StopsInReverseOrderAndKillsWhatDoesNotGo) {
  launch({shell("a", "trap 'echo stopped; exit 0' TERM; echo up; while :; do sleep 0.01; done"),
          shell("b", "trap 'echo stopped; exit 0' TERM; echo up; while :; do sleep 0.01; done", {0}),
          shell("c", "trap '' TERM; echo up; while :; do sleep 0.01; done", {1})});
  for (const char* line : {"a | up", "b | up", "c | up"}) ASSERT_TRUE(wait_for_line(line));
  stop();
  EXPECT_TRUE(success_);
  std::vector<std::string> ends;
  for (const std::string& line : lines()) {
    if (line.find("stop") != std::string::npos) ends.push_back(line);
  }
  EXPECT_THAT(ends, ElementsAre("c * does not stop, killing it", "b | stopped", "a | stopped"));
}

TEST_F(SupervisorTest, SecondStopKillsAtOnce) {
  launch({shell("a", "trap '' TERM; echo up; while :; do sleep 0.01; done")});
  ASSERT_TRUE(wait_for_line("a | up"));
  kill_.request_stop();
  stop();
  EXPECT_THAT(lines(), testing::Not(testing::Contains(HasSubstr("does not stop"))));
}

TEST_F(SupervisorTest, ProgramThatCannotStartFails) {
  ProcessPlan missing = shell("a", "");
  missing.program = "/nonexistent";
  launch({missing, shell("b", "echo up", {0})});
  wait_for_end();
  EXPECT_FALSE(success_);
  EXPECT_THAT(*supervisor_->failure(), HasSubstr("a: cannot start /nonexistent"));
  EXPECT_EQ(status("b").detail, "waits for a, which failed");
}

TEST_F(SupervisorTest, WhatCannotBeStartedForWantOfDescriptorsIsTriedAgain) {
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &before), 0);
  launch({shell("a", "sleep 0.5; exit 1"), shell("b", "sleep 100")});
  ASSERT_TRUE(wait_for_line("b * started"));
  const rlimit few{.rlim_cur = 256, .rlim_max = before.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &few), 0);
  std::vector<bus::FileDescriptor> taken;
  for (int fd = dup(0); fd >= 0; fd = dup(0)) taken.emplace_back(fd);
  const bool tried = wait_for_line("a * cannot make a pipe");
  taken.clear();
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &before), 0);
  EXPECT_TRUE(tried);
  EXPECT_TRUE(wait_for_line("a * started", 2));
  EXPECT_FALSE(supervisor_->failure().has_value());
}

}  // namespace
}  // namespace splatbus::cli
