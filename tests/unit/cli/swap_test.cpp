#include "swap.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <unistd.h>

#include <memory>
#include <vector>

#include "../bus/bus_fixture.h"
#include "../nanoseconds.h"
#include "swap_host.h"

namespace splatbus::cli {
namespace {

using testing::HasSubstr;
using Phase = Swap::Phase;
using State = wire::ServiceState;

class SwapOfTest : public testing::Test {
 protected:
  void old_says(State state) { swap.hear({"test", 1, state, kProtocolVersion, {}}, now); }
  void new_says(const std::string& source, State state, const std::string& detail = {},
                std::uint32_t protocol = kProtocolVersion) {
    swap.hear({source, 2, state, protocol, detail}, now);
  }
  wire::Order order() {
    now += kSecond;
    const auto due = swap.turn(now);
    return due ? due->order : wire::Order::None;
  }

  std::int64_t now = 100 * kSecond;
  Swap swap{"test", 1, 2, {.ready_s = 10, .yield_s = 10, .take_over_s = 10}, now};
};

TEST_F(SwapOfTest, OneLeavesBeforeTheOtherTakesOver) {
  EXPECT_EQ(order(), wire::Order::None);
  new_says("test.next", State::Starting);
  EXPECT_EQ(order(), wire::Order::None) << "it is not ready";
  new_says("test.next", State::Standby);
  EXPECT_EQ(order(), wire::Order::Yield);
  old_says(State::Running);
  EXPECT_EQ(order(), wire::Order::Yield) << "the order may have been lost";
  old_says(State::Stopping);
  EXPECT_EQ(order(), wire::Order::TakeOver);
  new_says("test", State::Starting);
  EXPECT_FALSE(swap.over());
  new_says("test", State::Running);
  EXPECT_EQ(swap.phase(), Phase::Done);
}

TEST_F(SwapOfTest, UntilTheSuccessorIsReadyNothingIsAskedOfTheOther) {
  new_says("test.next", State::Starting, "waits for the model");
  EXPECT_EQ(order(), wire::Order::None);
  now += 10 * kSecond;
  EXPECT_EQ(order(), wire::Order::None);
  EXPECT_EQ(swap.phase(), Phase::Refused);
  EXPECT_THAT(swap.refusal(), HasSubstr("not ready within 10 s: waits for the model"));
  EXPECT_FALSE(swap.has_yielded());
}

TEST_F(SwapOfTest, WhatFailsInTheOthersPlaceHasThatStartedAgain) {
  new_says("test.next", State::Standby);
  EXPECT_EQ(order(), wire::Order::Yield);
  swap.predecessor_ended(now);
  EXPECT_EQ(order(), wire::Order::TakeOver);
  swap.successor_ended("killed by signal 9");
  EXPECT_EQ(swap.phase(), Phase::Refused);
  EXPECT_TRUE(swap.has_yielded());
}

/// Real processes on a bus.
class SwapProcesses : public bus_test::BusTest {
 protected:
  SwapProcesses() : old_(bin("bus-test-service"), arguments({}), {}), heartbeats_(context_) {
    heartbeats_.on(topics::kHeartbeat, [this](const wire::Heartbeat& heartbeat, const bus::Message& message) {
      if (message.header().source()->str() == "test") last_ = {static_cast<pid_t>(heartbeat.pid()), heartbeat.state()};
    });
  }
  static std::string bin(const std::string& program) { return std::string(SPLATBUS_BIN_DIR) + "/" + program; }
  std::vector<std::string> arguments(std::vector<std::string> more) {
    more.insert(more.end(), {"--bus", directory_.address().text()});
    return more;
  }
  bool runs(pid_t pid) {
    last_ = {};
    return bus_test::eventually([&] {
      heartbeats_.dispatch_all(std::chrono::milliseconds(50));
      return last_ == std::pair(pid, State::Running);
    });
  }
  void swap_for(ChildSwapHost& host, double ready_s = 60) {
    run_swap(host, context_, "test", {.ready_s = ready_s}, [](const std::string&) {}, {});
  }
  /// Why it was refused; the old process is as it was.
  std::string refusal(const std::string& program, const std::vector<std::string>& with, double ready_s = 60) {
    EXPECT_TRUE(runs(old_.pid()));
    ChildSwapHost host(old_.pid(), program, with);
    std::string why;
    try {
      swap_for(host, ready_s);
    } catch (const std::runtime_error& error) {
      why = error.what();
    }
    EXPECT_FALSE(host.exchanged);
    EXPECT_FALSE(host.restarted);
    EXPECT_FALSE(host.successor.has_value());
    EXPECT_FALSE(old_.poll_exit().has_value());
    EXPECT_TRUE(runs(old_.pid()));
    return why;
  }

  std::shared_ptr<bus::Context> context_ = connect("tester");
  ChildProcess old_;
  bus::Subscriber heartbeats_;
  std::pair<pid_t, State> last_;
};

TEST_F(SwapProcesses, ASuccessorTakesNameAndSlabs) {
  ASSERT_TRUE(runs(old_.pid()));
  ChildSwapHost host(old_.pid(), bin("bus-test-service"), arguments({"--successor", "--set", "number=9"}));
  bus::Subscriber models(context_);
  std::uint64_t number = 0;
  models.on(Topic<wire::ViewerProbe>{"test/model", true},
            [&](const wire::ViewerProbe& model, const bus::Message&) { number = model.probe_id(); });
  swap_for(host);
  EXPECT_TRUE(host.exchanged);
  EXPECT_TRUE(runs(host.successor->pid()));
  EXPECT_TRUE(bus_test::eventually([&] { return old_.poll_exit().has_value(); }));
  EXPECT_TRUE(old_.poll_exit()->success());
  EXPECT_TRUE(bus_test::eventually([&] {
    models.dispatch_all(std::chrono::milliseconds(50));
    return number == 9;
  }));
}

/// Each keeps what it read with while it stood by; its name of then is the next one's all the same.
TEST_F(SwapProcesses, ThreeTimesInARow) {
  ASSERT_TRUE(runs(old_.pid()));
  std::vector<std::unique_ptr<ChildSwapHost>> hosts;
  pid_t pid = old_.pid();
  for (int time = 0; time < 3; ++time) {
    auto& host =
        hosts.emplace_back(std::make_unique<ChildSwapHost>(pid, bin("bus-test-service"), arguments({"--successor"})));
    ASSERT_NO_THROW(swap_for(*host)) << "time " << time << testing::PrintToString(host->lines);
    if (time > 0) {
      ChildProcess& before = *hosts.at(static_cast<std::size_t>(time) - 1)->successor;
      EXPECT_TRUE(bus_test::eventually([&] { return before.poll_exit().has_value(); }));
    } else {
      EXPECT_TRUE(bus_test::eventually([&] { return old_.poll_exit().has_value(); }));
    }
    pid = host->successor->pid();
    ASSERT_TRUE(runs(pid));
  }
}

TEST_F(SwapProcesses, OneThatCrashesAtStartIsRefused) {
  EXPECT_THAT(refusal(bin("bus-test-service"), arguments({"--successor", "--set", "rate_hz=99"})),
              testing::AllOf(HasSubstr("ended before it was ready: exited with status 2"), HasSubstr("from 1 to 10"),
                             HasSubstr("test goes on as it was")));
}

TEST_F(SwapProcesses, OneThatHangsIsRefused) {
  EXPECT_THAT(refusal("/bin/sleep", {"1000"}, 0.5), HasSubstr("sent no heartbeat within 0.5 s"));
}

TEST_F(SwapProcesses, OneOfAnotherProtocolIsRefused) {
  EXPECT_THAT(refusal(bin("swap-test-other-protocol"), {directory_.address().text()}),
              HasSubstr(fmt::format("speaks version {} of the protocol, this bus version {}", kProtocolVersion + 1,
                                    kProtocolVersion)));
}

/// Loses sight of its processes at a phase of the swap.
class BlindHost final : public ChildSwapHost {
 public:
  using ChildSwapHost::ChildSwapHost;
  [[nodiscard]] std::optional<std::string> successor_end() override {
    if (blind) throw std::runtime_error("nothing can be seen");
    return ChildSwapHost::successor_end();
  }
  void exchange() override { throw std::runtime_error("there is nobody beside it"); }
  bool blind = false;
};

TEST_F(SwapProcesses, WhatIsThrownLeavesNoSuccessorBeside) {
  ASSERT_TRUE(runs(old_.pid()));
  const auto why = [&](BlindHost& host) -> std::string {
    try {
      run_swap(host, context_, "test", {}, [](const std::string&) {}, {});
    } catch (const std::runtime_error& error) {
      return error.what();
    }
    return "nothing was thrown";
  };
  BlindHost blind(old_.pid(), bin("bus-test-service"), arguments({"--successor"}));
  blind.blind = true;
  EXPECT_EQ(why(blind), "nothing can be seen; test goes on as it was");
  EXPECT_FALSE(blind.successor.has_value());
  EXPECT_FALSE(blind.restarted) << "it was not told to leave";
  EXPECT_TRUE(runs(old_.pid()));

  BlindHost alone(old_.pid(), bin("bus-test-service"), arguments({"--successor"}));
  EXPECT_EQ(why(alone), "there is nobody beside it; test was started again as it was");
  EXPECT_FALSE(alone.successor.has_value());
  EXPECT_TRUE(alone.restarted) << "it has left";
}

TEST_F(SwapProcesses, AStraySecondOneTakesNothing) {
  ASSERT_TRUE(runs(old_.pid()));
  ChildProcess stray(bin("bus-test-service"), arguments({}), {});
  EXPECT_TRUE(bus_test::eventually([&] { return stray.poll_exit().has_value(); })) << "its slabs are refused";
  EXPECT_FALSE(stray.poll_exit()->success());
  EXPECT_TRUE(runs(old_.pid()));
}

}  // namespace
}  // namespace splatbus::cli
