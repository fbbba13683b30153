#include "supervisor.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <csignal>
#include <filesystem>
#include <map>
#include <memory>
#include <thread>
#include <zmq.hpp>

#include "bus/broker.h"
#include "bus/publisher.h"
#include "wire/system_generated.h"

namespace splatbus::cli {
namespace {

using namespace std::chrono_literals;
using testing::ElementsAre;
using testing::HasSubstr;

constexpr auto kPatience = 60s;

ProcessPlan shell(const std::string& name, const std::string& script, std::vector<std::size_t> after = {}) {
  ProcessPlan plan;
  plan.name = name;
  plan.program = "/bin/sh";
  plan.arguments = {"-c", script};
  plan.after = std::move(after);
  plan.heartbeat_timeout_s = 0;
  return plan;
}

/// Runs a plan on a thread, on a bus with an in-process broker, and remembers what was said.
class SupervisorTest : public testing::Test {
 protected:
  SupervisorTest() {
    std::string path = (std::filesystem::temp_directory_path() / "splatbus-supervisor-XXXXXX").string();
    folder_ = mkdtemp(path.data());
    broker_.emplace(bus_service::BrokerOptions{.address = bus::Address::parse("ipc://" + folder_)});
    broker_->start();
  }
  ~SupervisorTest() override {
    stop();
    supervisor_.reset();
    broker_.reset();
    std::filesystem::remove_all(folder_);
  }

  void launch(std::vector<ProcessPlan> processes) {
    LaunchPlan plan{bus::Address::parse("ipc://" + folder_), std::move(processes)};
    supervisor_.emplace(
        plan,
        [this](const std::string& process, const std::string& line, bool own) {
          const std::scoped_lock lock(mutex_);
          lines_.push_back(process + (own ? " * " : " | ") + line);
          changed_.notify_all();
        },
        [this] {
          ++clock_reads_;
          return clock_stopped_ ? stopped_at_ns_.load() : bus::now_ns();
        });
    thread_ = std::jthread([this] { success_ = supervisor_->run(stop_.get_token(), kill_.get_token()); });
  }

  void stop() {
    stop_.request_stop();
    wait_for_end();
  }
  void wait_for_end() {
    if (thread_.joinable()) thread_.join();
  }

  [[nodiscard]] bool wait_for_line(const std::string& text, std::size_t times = 1) {
    std::unique_lock lock(mutex_);
    return changed_.wait_for(lock, kPatience, [&] {
      return static_cast<std::size_t>(std::count_if(lines_.begin(), lines_.end(), [&](const std::string& line) {
               return line.find(text) != std::string::npos;
             })) >= times;
    });
  }

  [[nodiscard]] std::vector<std::string> lines() {
    const std::scoped_lock lock(mutex_);
    return lines_;
  }

  [[nodiscard]] ProcessStatus status(const std::string& name) const {
    for (const ProcessStatus& status : supervisor_->status()) {
      if (status.name == name) return status;
    }
    return {};
  }

  [[nodiscard]] bool wait_for_state(const std::string& name, ProcessState state) const {
    const auto end = std::chrono::steady_clock::now() + kPatience;
    while (status(name).state != state) {
      if (std::chrono::steady_clock::now() > end) return false;
      std::this_thread::yield();
    }
    return true;
  }

  /// The supervisor's clock stands still, but for pass(). Before launch().
  void stop_clock() {
    stopped_at_ns_ = bus::now_ns();
    clock_stopped_ = true;
  }
  /// Moves a clock that was stopped, and returns when the supervisor has judged everything by the new time.
  void pass(double seconds) {
    stopped_at_ns_ += static_cast<std::int64_t>(seconds * 1e9);
    constexpr std::uint64_t kReadsInTwoRounds = 6;  // at least two are in each
    const std::uint64_t enough = clock_reads_ + kReadsInTwoRounds;
    while (clock_reads_ < enough) std::this_thread::yield();
  }

  std::string folder_;
  std::optional<bus_service::Broker> broker_;
  std::atomic<bool> clock_stopped_ = false;
  std::atomic<std::int64_t> stopped_at_ns_ = 0;
  std::atomic<std::uint64_t> clock_reads_ = 0;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<std::string> lines_;
  std::optional<Supervisor> supervisor_;
  std::stop_source stop_, kill_;
  std::atomic<bool> success_ = false;
  std::jthread thread_;
};

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

/// Sends heartbeats as if it were the processes, by a clock that stands still.
class HeartbeatTest : public SupervisorTest {
 protected:
  HeartbeatTest() { stop_clock(); }

  /// A heartbeat of `source`, of a process `pid` as it says.
  void beat(const std::string& source, pid_t pid) {
    auto found = publishers_.find(source);
    if (found == publishers_.end()) {
      const auto context = bus::Context::create(bus::Address::parse("ipc://" + folder_), source);
      found = publishers_.emplace(source, std::make_unique<bus::Publisher>(context)).first;
    }
    found->second->publish(Topic<wire::Heartbeat>{"sys/heartbeat"}, [&](auto& builder, auto header) {
      const std::vector counters{wire::CreateCounterDirect(builder, "frames", 42.0)};
      return wire::CreateHeartbeatDirect(builder, header, "fake", static_cast<std::uint32_t>(pid),
                                         wire::ServiceState::Running, "fine", &counters);
    });
  }

  /// Until `condition` holds, `source` sending the heartbeats of process `name` all the while when that runs.
  template <class Condition>
  [[nodiscard]] bool beat_until(const std::string& source, const std::string& name, Condition condition) {
    const auto end = std::chrono::steady_clock::now() + kPatience;
    while (!condition()) {
      if (std::chrono::steady_clock::now() > end) return false;
      if (const pid_t pid = status(name).pid; pid != 0) beat(source, pid);
      pass(0);
    }
    return true;
  }

  [[nodiscard]] bool was_said(const std::string& line) {
    const auto said = lines();
    return std::find(said.begin(), said.end(), line) != said.end();
  }

  static ProcessPlan beating(const std::string& name, std::vector<std::size_t> after = {}) {
    ProcessPlan plan = shell(name, "exec sleep 100", std::move(after));
    plan.heartbeat_timeout_s = 2;
    return plan;
  }

  std::map<std::string, std::unique_ptr<bus::Publisher>> publishers_;
};

TEST_F(HeartbeatTest, ReadyWithTheFirstHeartbeatAndThenOthersStart) {
  launch({beating("a"), shell("b", "exec sleep 100", {0})});
  ASSERT_TRUE(wait_for_state("a", ProcessState::Starting));
  EXPECT_EQ(status("b").state, ProcessState::Waiting);
  ASSERT_TRUE(beat_until("a", "a", [&] { return status("b").state == ProcessState::Running; }));
  EXPECT_EQ(status("a").state, ProcessState::Running);
  EXPECT_EQ(status("a").detail, "fine");
  EXPECT_EQ(status("a").counters.at("frames"), 42.0);
}

TEST_F(HeartbeatTest, SilentProcessIsKilledAndStartedAgain) {
  launch({beating("a")});
  ASSERT_TRUE(beat_until("a", "a", [&] { return status("a").state == ProcessState::Running; }));
  pass(1.9);
  EXPECT_EQ(status("a").state, ProcessState::Running);
  pass(0.2);
  EXPECT_TRUE(wait_for_line("a * no heartbeat for 2 s, killing it"));
  EXPECT_TRUE(wait_for_line("a * killed by signal 9"));
  ASSERT_TRUE(wait_for_state("a", ProcessState::BackOff));
  pass(0.2);
  EXPECT_TRUE(wait_for_line("a * started", 2));
}

TEST_F(HeartbeatTest, NobodyElseSpeaksForASilentProcess) {
  launch({beating("a")});
  ASSERT_TRUE(beat_until("a", "a", [&] { return status("a").state == ProcessState::Running; }));
  // A process of another machine that happens to have the same id goes on.
  EXPECT_TRUE(beat_until("remote", "a", [&] {
    pass(0.25);
    return was_said("a * no heartbeat for 2 s, killing it");
  }));
}

TEST_F(HeartbeatTest, EarlierLifeDoesNotMakeReady) {
  launch({beating("a"), shell("b", "exec sleep 100", {0})});
  ASSERT_TRUE(wait_for_state("a", ProcessState::Starting));
  const pid_t earlier = status("a").pid + 1;
  for (int i = 0; i < 20; ++i) {
    beat("a", earlier);
    pass(0);
  }
  EXPECT_EQ(status("a").state, ProcessState::Starting);
}

TEST_F(HeartbeatTest, NeverReadyIsKilledToo) {
  ProcessPlan plan = beating("a");
  plan.start_timeout_s = 0.2;
  launch({plan});
  ASSERT_TRUE(wait_for_state("a", ProcessState::Starting));
  pass(0.3);
  EXPECT_TRUE(wait_for_line("a * no heartbeat for 0.2 s, killing it"));
}

/// A broker that believes whoever calls himself "bus".
class CredulousBroker {
 public:
  explicit CredulousBroker(const bus::Address& address) {
    from_publishers_.bind(address.publish_endpoint());
    to_subscribers_.bind(address.subscribe_endpoint());
    thread_ = std::thread([this] { zmq_proxy(from_publishers_.handle(), to_subscribers_.handle(), nullptr); });
  }
  ~CredulousBroker() {
    context_.shutdown();
    thread_.join();
  }
  CredulousBroker(const CredulousBroker&) = delete;
  CredulousBroker& operator=(const CredulousBroker&) = delete;

 private:
  zmq::context_t context_;
  zmq::socket_t from_publishers_{context_, zmq::socket_type::xsub}, to_subscribers_{context_, zmq::socket_type::xpub};
  std::thread thread_;
};

TEST_F(HeartbeatTest, SilenceIsForgivenWhileTheBrokerIsSilent) {
  broker_.reset();
  const CredulousBroker credulous(bus::Address::parse("ipc://" + folder_));
  ProcessPlan broker = beating("the-broker");
  broker.broker = true;
  broker.heartbeat_timeout_s = 1000;
  launch({broker, beating("a", {0})});
  ASSERT_TRUE(beat_until("bus", "the-broker", [&] { return status("a").state == ProcessState::Starting; }));
  ASSERT_TRUE(beat_until("a", "a", [&] { return status("a").state == ProcessState::Running; }));
  // Nobody beats for longer than is allowed, and nobody is killed; then only the broker beats.
  pass(3);
  EXPECT_FALSE(was_said("a * no heartbeat for 2 s, killing it"));
  EXPECT_TRUE(beat_until("bus", "the-broker", [&] { return was_said("a * no heartbeat for 2 s, killing it"); }));
}

}  // namespace
}  // namespace splatbus::cli
