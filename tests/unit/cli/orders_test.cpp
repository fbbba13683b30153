// What an operator asks of a supervisor, with real processes.
#include <gmock/gmock.h>
#include <unistd.h>

#include <csignal>
#include <fstream>
#include <string>

#include "supervisor_fixture.h"

namespace splatbus::cli {
namespace {

using testing::HasSubstr;

constexpr const char* kSleep = "exec sleep 1000";

TEST_F(SupervisorTest, StoppedStaysStoppedUntilItIsStarted) {
  launch({shell("a", kSleep), shell("b", kSleep, {0})});
  ASSERT_TRUE(wait_for_state("b", ProcessState::Running));
  const pid_t b = status("b").pid;
  supervisor_->stop("a");
  ASSERT_TRUE(wait_for_state("a", ProcessState::Stopped));
  EXPECT_EQ(status("a").pid, 0);
  EXPECT_EQ(status("b").pid, b) << "the rest goes on";
  supervisor_->start("a");
  ASSERT_TRUE(wait_for_state("a", ProcessState::Running));
  EXPECT_TRUE(supervisor_->failure() == std::nullopt);
  stop();
  EXPECT_TRUE(success_);
}

TEST_F(SupervisorTest, ARestartIsAnotherProcess) {
  launch({shell("a", kSleep)});
  ASSERT_TRUE(wait_for_state("a", ProcessState::Running));
  const pid_t before = status("a").pid;
  supervisor_->restart("a");
  ASSERT_TRUE(supervisor_->wait_until(
      [&](const auto& all) { return all[0].state == ProcessState::Running && all[0].pid != before; }, kPatience));
  EXPECT_EQ(status("a").restarts, 1);
}

TEST_F(SupervisorTest, WhatFailedForGoodIsStartedAgainOnOrder) {
  const std::string mark = folder_ + "/mended";
  launch({shell("a", "test -e " + mark + " || exit 78; " + kSleep), shell("b", kSleep)});
  ASSERT_TRUE(wait_for_state("a", ProcessState::Failed));
  EXPECT_EQ(status("a").restarts, 0) << "it said itself that it would only fail again";
  EXPECT_TRUE(supervisor_->failure().has_value());
  ASSERT_EQ(system(("touch " + mark).c_str()), 0);
  supervisor_->start("a");
  ASSERT_TRUE(wait_for_state("a", ProcessState::Running));
  EXPECT_FALSE(supervisor_->failure().has_value());
  stop();
  EXPECT_TRUE(success_);
}

TEST_F(SupervisorTest, WhatDoesNotRunAtTheEndIsAFailure) {
  launch({shell("a", "exit 1"), shell("b", kSleep)});
  ASSERT_TRUE(wait_for_state("a", ProcessState::BackOff));
  stop();
  EXPECT_FALSE(success_);
  EXPECT_THAT(supervisor_->not_running(), testing::ElementsAre(HasSubstr("a: ")));
}

TEST_F(SupervisorTest, ProcessesComeAndGo) {
  launch({shell("a", kSleep)});
  ASSERT_TRUE(wait_for_state("a", ProcessState::Running));
  supervisor_->add(shell("a-2", kSleep), {"a"});
  ASSERT_TRUE(wait_for_state("a-2", ProcessState::Running));
  EXPECT_THROW(supervisor_->add(shell("a-2", kSleep), {}), std::runtime_error);
  supervisor_->remove("a-2");
  EXPECT_TRUE(supervisor_->wait_until([](const auto& all) { return all.size() == 1; }, kPatience));
  EXPECT_THROW(supervisor_->restart("a-2"), std::runtime_error);
}

TEST_F(SupervisorTest, ASuccessorTakesThePlaceAndThePredecessorLeaves) {
  launch({shell("a", kSleep)});
  ASSERT_TRUE(wait_for_state("a", ProcessState::Running));
  const pid_t old = status("a").pid;
  supervisor_->start_successor("a", shell("a", "echo beside; " + std::string(kSleep)));
  EXPECT_TRUE(wait_for_line("a.next | beside"));
  const pid_t next = status("a").beside->pid;
  EXPECT_EQ(status("a").pid, old) << "nothing has changed yet";
  supervisor_->exchange("a", 0);
  EXPECT_EQ(status("a").pid, next);
  ASSERT_TRUE(supervisor_->wait_until([](const auto& all) { return !all[0].beside; }, kPatience));
  EXPECT_EQ(kill(old, 0), -1);
  EXPECT_EQ(status("a").state, ProcessState::Running);
  EXPECT_EQ(status("a").restarts, 0);
}

TEST_F(SupervisorTest, WhatWasASuccessorIsStartedAgainAsNone) {
  launch({shell("a", kSleep)});
  ASSERT_TRUE(wait_for_state("a", ProcessState::Running));
  ProcessPlan plan = shell("a", "echo \"with $*.\"; " + std::string(kSleep));
  plan.arguments.insert(plan.arguments.end(), {"sh", "--set", "--successor", "x=1"});
  supervisor_->start_successor("a", plan);
  ASSERT_TRUE(wait_for_line("a.next | with --set --successor x=1."));
  supervisor_->exchange("a", 0);
  ASSERT_TRUE(supervisor_->wait_until([](const auto& all) { return !all[0].beside; }, kPatience));
  supervisor_->restart("a");
  ASSERT_TRUE(wait_for_line("a | with "));
  EXPECT_THAT(lines(), testing::Contains("a | with --set x=1."));
}

TEST_F(SupervisorTest, ASuccessorThatDiesChangesNothing) {
  launch({shell("a", kSleep)});
  ASSERT_TRUE(wait_for_state("a", ProcessState::Running));
  const pid_t old = status("a").pid;
  supervisor_->start_successor("a", shell("a", "echo no; exit 3"));
  ASSERT_TRUE(supervisor_->wait_until([](const auto& all) { return all[0].beside && all[0].beside->exit.has_value(); },
                                      kPatience));
  EXPECT_EQ(status("a").beside->exit->code, 3);
  EXPECT_THAT(status("a").beside->last_lines, testing::ElementsAre("no"));
  EXPECT_THROW(supervisor_->exchange("a", 0), std::runtime_error);
  supervisor_->drop_beside("a");
  EXPECT_FALSE(status("a").beside);
  EXPECT_EQ(status("a").pid, old);
}

/// Between one that has handed over and its successor there is nobody else, whatever the policy.
TEST_F(SupervisorTest, WhatEndsBesideItsSuccessorWaitsForIt) {
  const std::string leave = folder_ + "/leave";
  ProcessPlan plan = shell("a", "echo up; while test ! -e " + leave + "; do sleep 0.01; done; exit 0");
  plan.restart = RestartPolicy::Always;
  launch({plan});
  ASSERT_TRUE(wait_for_line("a | up"));
  supervisor_->start_successor("a", shell("a", kSleep));
  EXPECT_THROW(supervisor_->restart("a"), std::runtime_error) << "it is being swapped";
  EXPECT_THROW(supervisor_->stop("a"), std::runtime_error);
  std::ofstream{leave};
  ASSERT_TRUE(wait_for_line("a * its process exited with status 0"));
  ASSERT_TRUE(wait_for_state("a", ProcessState::Stopping));
  EXPECT_EQ(status("a").pid, 0);
  std::filesystem::remove(leave);
  supervisor_->drop_beside("a");
  EXPECT_TRUE(wait_for_line("a | up", 2)) << "its policy's turn, once the successor is refused";

  ASSERT_TRUE(supervisor_->wait_until([](const auto& all) { return !all[0].beside; }, kPatience));
  supervisor_->start_successor("a", shell("a", "echo second; " + std::string(kSleep)));
  ASSERT_TRUE(wait_for_line("a.next | second"));
  std::ofstream{leave};
  ASSERT_TRUE(wait_for_line("a * its process exited with status 0", 2));
  const pid_t successor = status("a").beside->pid;
  supervisor_->exchange("a", 0);
  EXPECT_EQ(status("a").pid, successor);
  EXPECT_EQ(status("a").state, ProcessState::Running);
}

/// Whoever sent it was not the supervisor.
TEST_F(SupervisorTest, WhatASignalFromOutsideStoppedIsStartedAgain) {
  launch({shell("a", "trap 'exit 143' TERM; echo up; while :; do sleep 0.01; done")});
  ASSERT_TRUE(wait_for_line("a | up"));
  ASSERT_TRUE(wait_for_state("a", ProcessState::Running));
  const pid_t pid = status("a").pid;
  ASSERT_GT(pid, 0) << "0 would be this test's whole group";
  kill(pid, SIGTERM);
  EXPECT_TRUE(wait_for_line("stopped by signal 15 (Terminated); starting it again"));
  EXPECT_TRUE(wait_for_line("a | up", 2));
  supervisor_->stop("a");
  EXPECT_TRUE(wait_for_state("a", ProcessState::Stopped));
}

/// So that what drains ends by itself.
TEST_F(SupervisorTest, ProcessesKnowWhenTheyWouldBeKilled) {
  ProcessPlan plan = shell("a", "echo after $SPLATBUS_STOP_TIMEOUT_S; " + std::string(kSleep));
  plan.stop_timeout_s = 7.5;
  launch({plan});
  EXPECT_TRUE(wait_for_line("a | after 7.5"));
}

TEST_F(SupervisorTest, OrdersAreRefusedWhenItIsOver) {
  launch({shell("a", "exit 0")});
  wait_for_end();
  EXPECT_THROW(supervisor_->start("a"), std::runtime_error);
}

}  // namespace
}  // namespace splatbus::cli
