// Verbs of an operator over the supervisor's socket, one after the other, with real processes.
#include <gmock/gmock.h>

#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>

#include "control_request.h"
#include "operator_verbs.h"
#include "supervisor_fixture.h"
#include "swap_verb.h"
#include "wire/system_generated.h"

namespace splatbus::cli {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;
using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;

void touch(const std::string& file) {
  const std::ofstream made(file);
}

/// A launch file under a supervisor that answers.
class OperatedTest : public SupervisorTest {
 protected:
  void up(const std::string& yaml) {
    const LaunchFile file = parse_launch_file(yaml, "test.yaml");
    launch(plan_launch(file, address(), program_directory()).processes);
    operated_ = std::make_shared<Operated>(
        Operated{.supervisor = *supervisor_, .file = file, .bus = address(), .log_folder = {}, .stop = [] {}});
    server_.emplace(address());
    add_operator_verbs(*server_, operated_);
    add_swap_handler(*server_, operated_);
    server_->start();
  }
  ~OperatedTest() override {
    if (server_) server_->stop();
  }

  [[nodiscard]] bus::Address address() const { return bus::Address::parse("ipc://" + folder_); }
  [[nodiscard]] Json ask(const Json& request) const { return ask_supervisor(address(), request); }
  [[nodiscard]] std::string refusal(const Json& request) const {
    try {
      return "no refusal, but " + ask(request).dump();
    } catch (const std::exception& error) {
      return error.what();
    }
  }
  [[nodiscard]] Json scale(const std::string& service, int replicas) const {
    return ask({{"verb", "scale"}, {"service", service}, {"replicas", replicas}});
  }
  [[nodiscard]] std::vector<std::string> names() const {
    std::vector<std::string> result;
    for (const ProcessStatus& process : supervisor_->status()) result.push_back(process.name);
    return result;
  }

  std::shared_ptr<Operated> operated_;
  std::optional<ControlServer> server_;
};

constexpr const char* kStreamersAndProbe =
    "services:\n"
    "  - {name: streamer, program: /bin/sleep, args: ['1000'], heartbeat_timeout_s: 0}\n"
    "  - {name: gateway, program: /bin/sleep, args: ['1000'], heartbeat_timeout_s: 0,\n"
    "     readiness: {command: [test, -e, 'GATE'], period_s: 0.05}}\n"
    "  - {name: probe, program: /bin/sleep, args: ['1000'], heartbeat_timeout_s: 0, after: [gateway]}\n";

std::string with_gate(const std::string& gate) {
  std::string yaml = kStreamersAndProbe;
  return yaml.replace(yaml.find("GATE"), 4, gate);
}

/// A plan of today has other indices than the one that everything was started by.
TEST_F(OperatedTest, AReplicaWaitsForWhatItsServiceWaitsFor) {
  const std::string gate = folder_ + "/gate";
  up(with_gate(gate));
  EXPECT_THAT(scale("streamer", 2).at("added"), ElementsAre("streamer-2"));
  static_cast<void>(ask({{"verb", "stop"}, {"services", {"probe"}}}));
  EXPECT_THAT(refusal({{"verb", "scale"}, {"service", "probe"}, {"replicas", 2}, {"wait_s", 0.3}}),
              HasSubstr("probe-2 is waiting"));
  touch(gate);
  EXPECT_TRUE(wait_for_state("probe-2", ProcessState::Running)) << "the gateway is ready, and nothing else counts";
  EXPECT_EQ(status("probe").state, ProcessState::Stopped);
}

/// The first replica goes on under the name that it was started by, and is waited for by that.
TEST_F(OperatedTest, AReplicaWaitsForAFirstOneOfAnOlderName) {
  const std::string gate = folder_ + "/gate";
  up(with_gate(gate));
  EXPECT_THAT(refusal({{"verb", "scale"}, {"service", "gateway"}, {"replicas", 2}, {"wait_s", 0}}),
              HasSubstr("gateway-2 is "));
  static_cast<void>(ask({{"verb", "stop"}, {"services", {"gateway"}}}));
  touch(gate);
  ASSERT_TRUE(wait_for_state("gateway-2", ProcessState::Running));
  EXPECT_THAT(refusal({{"verb", "scale"}, {"service", "probe"}, {"replicas", 2}, {"wait_s", 0.3}}),
              HasSubstr("probe-2 is waiting"));
  static_cast<void>(ask({{"verb", "start"}, {"services", {"gateway"}}}));
  EXPECT_TRUE(wait_for_state("probe-2", ProcessState::Running));
}

TEST_F(OperatedTest, ScaleAfterScaleLeavesNoGhost) {
  const std::string gate = folder_ + "/gate";
  touch(gate);
  up(with_gate(gate));
  static_cast<void>(scale("streamer", 3));
  static_cast<void>(scale("probe", 2));
  EXPECT_THAT(names(), ElementsAre("streamer", "gateway", "probe", "streamer-2", "streamer-3", "probe-2"));
  EXPECT_TRUE(wait_for_state("probe-2", ProcessState::Running));
  EXPECT_THAT(scale("streamer", 1).at("removed"), ElementsAre("streamer-3", "streamer-2"));
  EXPECT_EQ(names().size(), 4U);
}

TEST_F(OperatedTest, ReplicasThatCannotBeStartedAreNotLeftBehind) {
  const std::string broken = folder_ + "/broken";
  up("services:\n  - {name: streamer, program: /bin/sh, args: ['-c', 'test ! -e " + broken +
     " || exit 3; sleep 1000'], heartbeat_timeout_s: 0,\n"
     "     restart: {policy: on-failure, max_attempts: 2}, readiness: {command: [test, '!', -e, '" +
     broken + "'], period_s: 0.05}}\n");
  static_cast<void>(scale("streamer", 2));
  touch(broken);
  EXPECT_THAT(refusal({{"verb", "scale"}, {"service", "streamer"}, {"replicas", 4}, {"wait_s", 60}}),
              AllOf(HasSubstr("streamer-3 is "), HasSubstr("removed again: streamer-4, streamer-3")));
  EXPECT_THAT(names(), ElementsAre("streamer", "streamer-2"));
  EXPECT_EQ(status("streamer-2").state, ProcessState::Running);
  std::filesystem::remove(broken);
  EXPECT_THAT(scale("streamer", 3).at("added"), ElementsAre("streamer-3"));
}

TEST_F(OperatedTest, AMistypedServiceGetsTheNearestOne) {
  up("services:\n  - {name: streamer, program: /bin/sleep, args: ['1000'], heartbeat_timeout_s: 0, replicas: 2}\n");
  for (const char* verb : {"start", "stop", "restart"}) {
    EXPECT_THAT(refusal({{"verb", verb}, {"services", {"steramer"}}}), HasSubstr("did you mean 'streamer'?")) << verb;
  }
  EXPECT_THAT(refusal({{"verb", "stop"}, {"services", {"streamr-2"}}}), HasSubstr("did you mean 'streamer-2'?"));
  EXPECT_THAT(refusal({{"verb", "swap"}, {"service", "steramer"}}), HasSubstr("did you mean 'streamer'?"));
  EXPECT_THAT(refusal({{"verb", "scale"}, {"service", "steramer"}, {"replicas", 2}}),
              HasSubstr("did you mean 'streamer'?"));
  EXPECT_THAT(refusal({{"verb", "stop"}, {"services", {"x"}}}), HasSubstr("(known: streamer, streamer-1, streamer-2)"));
}

/// What each process says on the bus that it is set to.
class SwappedService : public OperatedTest {
 protected:
  SwappedService() : heartbeats_(bus::Context::create(address(), "tester")) {
    heartbeats_.on(topics::kHeartbeat, [this](const wire::Heartbeat& heartbeat, const bus::Message& message) {
      if (heartbeat.parameters() == nullptr) return;
      for (const auto* entry : *heartbeat.parameters()) {
        if (entry->key()->string_view() == "number") {
          numbers_[message.header().source()->str()] = entry->value()->str();
        }
      }
    });
  }
  [[nodiscard]] bool has_number(const std::string& source, const std::string& number) {
    const auto end = std::chrono::steady_clock::now() + kPatience;
    while (numbers_[source] != number) {
      if (std::chrono::steady_clock::now() > end) return false;
      heartbeats_.dispatch_all(50ms);
    }
    return true;
  }
  static std::string launch_file(int replicas) {
    return "services:\n  - {name: test, program: '" SPLATBUS_BIN_DIR "/bus-test-service', replicas: " +
           std::to_string(replicas) + "}\n";
  }

  bus::Subscriber heartbeats_;
  std::map<std::string, std::string> numbers_;
};

TEST_F(SwappedService, ReplicasThatComeLaterAreOfTheNewKind) {
  up(launch_file(1));
  ASSERT_TRUE(wait_for_state("test", ProcessState::Running));
  static_cast<void>(ask({{"verb", "swap"}, {"service", "test"}, {"set", {{"number", "9"}}}}));
  static_cast<void>(scale("test", 2));
  EXPECT_TRUE(has_number("test-2", "9"));
  // One of two is another matter: the file still says what the service is.
  static_cast<void>(ask({{"verb", "swap"}, {"service", "test-2"}, {"set", {{"number", "5"}}}}));
  static_cast<void>(scale("test", 3));
  EXPECT_TRUE(has_number("test-3", "9"));
}

TEST_F(SwappedService, ReplicasThatWereSwappedOneByOneAreTheServiceInTheEnd) {
  up(launch_file(2));
  ASSERT_TRUE(wait_for_state("test-1", ProcessState::Running));
  ASSERT_TRUE(wait_for_state("test-2", ProcessState::Running));
  static_cast<void>(ask({{"verb", "swap"}, {"service", "test-1"}, {"set", {{"number", "9"}}}}));
  static_cast<void>(scale("test", 3));
  ASSERT_TRUE(wait_for_state("test-3", ProcessState::Running));
  EXPECT_FALSE(numbers_["test-3"] == "9") << "one of two is not the service";
  static_cast<void>(ask({{"verb", "swap"}, {"service", "test-3"}, {"set", {{"number", "9"}}}}));
  static_cast<void>(ask({{"verb", "swap"}, {"service", "test-2"}, {"set", {{"number", "9"}}}}));
  static_cast<void>(scale("test", 4));
  EXPECT_TRUE(has_number("test-4", "9"));
}

TEST_F(SwappedService, TheOneBeforeIsWaitedForNoLongerThanTheCommandSays) {
  up("services:\n  - name: test\n    program: '" SPLATBUS_BIN_DIR
     "/bus-test-service'\n    parameters: {linger_s: 1000}\n");
  ASSERT_TRUE(wait_for_state("test", ProcessState::Running));
  static_cast<void>(ask({{"verb", "swap"}, {"service", "test"}}));
  const auto begin = std::chrono::steady_clock::now();
  EXPECT_THAT(refusal({{"verb", "swap"}, {"service", "test"}, {"wait_s", 0.5}}),
              HasSubstr("before the last swap has not ended within 0.5 s"));
  EXPECT_LT(std::chrono::steady_clock::now() - begin, 5s);
}

TEST_F(OperatedTest, HowLongAnEndMayTakeIsWhatItsProcessesMay) {
  up("services:\n"
     "  - {name: slow, program: /bin/sleep, args: ['1000'], heartbeat_timeout_s: 0, stop_timeout_s: 120, replicas: 2}\n"
     "  - {name: quick, program: /bin/sleep, args: ['1000'], heartbeat_timeout_s: 0, stop_timeout_s: 7}\n");
  for (const char* name : {"slow-1", "slow-2", "quick"}) ASSERT_TRUE(wait_for_state(name, ProcessState::Running));
  const Json answer = ask({{"verb", "down"}});
  EXPECT_EQ(answer.at("stops_within_s"), 247);
  EXPECT_GT(stop_patience_s(answer), 247) << "how long 'down' waits where nothing is said";
  EXPECT_EQ(stop_patience_s({{"stops_within_s", 9}}), 60);
  static_cast<void>(ask({{"verb", "stop"}, {"services", {"slow-2"}}}));
  EXPECT_EQ(ask({{"verb", "down"}}).at("stops_within_s"), 127) << "what does not run takes no time";
}

TEST_F(SwappedService, ARefusalNamesThoseThatAreSwappedAlready) {
  const fs::path picky = fs::path(folder_) / "picky";
  std::ofstream(picky) << "#!/bin/sh\ncase \"$*\" in *test-2*) echo 'not me'; exit 3;; esac\n"
                       << "exec " SPLATBUS_BIN_DIR "/bus-test-service \"$@\"\n";
  fs::permissions(picky, fs::perms::owner_all);
  up(launch_file(2));
  ASSERT_TRUE(wait_for_state("test-1", ProcessState::Running));
  ASSERT_TRUE(wait_for_state("test-2", ProcessState::Running));
  EXPECT_THAT(refusal({{"verb", "swap"}, {"service", "test"}, {"program", picky.string()}}),
              AllOf(HasSubstr("test-2: the successor ended"), HasSubstr("test-2 goes on as it was"),
                    HasSubstr("already swapped, and still so: test-1")));
  EXPECT_EQ(supervisor_->plan_of("test-1").program, picky);
  static_cast<void>(scale("test", 3));
  EXPECT_NE(supervisor_->plan_of("test-3").program, picky) << "the service was not swapped";
}

}  // namespace
}  // namespace splatbus::cli
