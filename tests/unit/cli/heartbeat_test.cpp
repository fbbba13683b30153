// What the supervisor makes of heartbeats, and of their absence.
#include <algorithm>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>
#include <zmq.hpp>

#include "bus/context.h"
#include "bus/publisher.h"
#include "supervisor_fixture.h"
#include "wire/system_generated.h"

namespace splatbus::cli {
namespace {

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
