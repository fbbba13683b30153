#include <gmock/gmock.h>

#include <cerrno>
#include <cstdlib>

#include "bus/bind.h"
#include "bus/permanent_error.h"
#include "bus_fixture.h"
#include "child_process.h"
#include "wire/system_generated.h"

namespace splatbus::bus_test {
namespace {

using testing::HasSubstr;

/// service_main in a process of its own.
class Service : public BusTest {
 protected:
  Service() : context_(connect("tester")), heartbeats_(context_, {"sys/heartbeat"}), logs_(context_, {"sys/log"}) {}

  std::unique_ptr<ChildProcess> start(std::vector<std::string> arguments = {}) {
    arguments.insert(arguments.end(), {"--bus", directory_.address().text()});
    return std::make_unique<ChildProcess>("bus-test-service", arguments, output_path());
  }
  [[nodiscard]] std::string output_path() const { return directory_.path() + "/output"; }

  // Waits for a heartbeat of `source` that is as wanted.
  bool await_heartbeat(const std::string& source, const std::function<bool(const wire::Heartbeat&)>& wanted) {
    return eventually([&] {
      const auto message = heartbeats_.receive(100ms);
      return message && message->header().source()->str() == source && wanted(message->root<wire::Heartbeat>());
    });
  }

  bool await_log(wire::LogLevel level, const std::string& text) {
    return eventually([&] {
      const auto message = logs_.receive(100ms);
      if (!message) return false;
      const auto& log = message->root<wire::Log>();
      return log.level() == level && log.text()->str().find(text) != std::string::npos;
    });
  }

  void control(const std::string& topic, const std::string& name, const std::string& value) {
    const bus::Publisher publisher(context_);
    publisher.publish(topics::control(topic), [&](auto& builder, auto header) {
      const std::vector<flatbuffers::Offset<wire::KeyValue>> changes{
          wire::CreateKeyValueDirect(builder, name.c_str(), value.c_str())};
      return wire::CreateControlDirect(builder, header, &changes);
    });
  }

  std::shared_ptr<bus::Context> context_;
  bus::Subscriber heartbeats_;
  bus::Subscriber logs_;
};

std::string parameter(const wire::Heartbeat& heartbeat, const std::string& name) {
  for (const auto* entry : *heartbeat.parameters()) {
    if (entry->key()->str() == name) return entry->value()->str();
  }
  return {};
}

TEST_F(Service, HeartbeatsTellStateCountersAndParameters) {
  const auto child = start({"--name", "test-2", "--set", "number=9", "--set", "rate_hz=2.5"});
  EXPECT_TRUE(await_heartbeat("test-2", [&](const wire::Heartbeat& heartbeat) {
    return heartbeat.state() == wire::ServiceState::Running && heartbeat.service()->str() == "test" &&
           heartbeat.pid() == static_cast<std::uint32_t>(child->pid()) && heartbeat.detail()->str() == "counting" &&
           heartbeat.counters()->size() == 1 && heartbeat.counters()->Get(0)->name()->str() == "turns" &&
           heartbeat.counters()->Get(0)->value() > 0 && parameter(heartbeat, "number") == "9" &&
           parameter(heartbeat, "rate_hz") == "2.5";
  }));
}

// The broker refuses a heartbeat that says more: the service would look dead.
TEST_F(Service, WhatIsTooLongForAHeartbeatIsCut) {
  const auto child = start({"--name", "test-2", "--set", "fixed=" + std::string(5000, 'v')});
  EXPECT_TRUE(await_heartbeat("test-2", [&](const wire::Heartbeat& heartbeat) {
    return heartbeat.state() == wire::ServiceState::Running && heartbeat.counters()->size() == 2 &&
           heartbeat.counters()->Get(0)->name()->str() == std::string(253, 'n') + "..." &&
           parameter(heartbeat, "fixed") == std::string(4093, 'v') + "...";
  }));
}

TEST_F(Service, ParametersChangeByKindAndByName) {
  const auto child = start({"--name", "test-2"});
  ASSERT_TRUE(await_heartbeat("test-2", [](const auto& beat) { return beat.state() == wire::ServiceState::Running; }));
  control("control/test", "number", "21");
  EXPECT_TRUE(await_heartbeat("test-2", [](const auto& beat) { return parameter(beat, "number") == "21"; }));
  control("control/test-2", "number", "22");
  EXPECT_TRUE(await_heartbeat("test-2", [](const auto& beat) { return parameter(beat, "number") == "22"; }));
  control("control/test-2", "rate_hz", "1000");
  EXPECT_TRUE(await_log(wire::LogLevel::Error, "rate_hz"));
  control("control/test-2", "fixed", "b");
  EXPECT_TRUE(await_log(wire::LogLevel::Error, "fixed"));
  EXPECT_TRUE(await_heartbeat("test-2", [](const auto& beat) { return parameter(beat, "fixed") == "a"; }));
}

TEST_F(Service, SigtermAndSigintStopIt) {
  for (const int signal : {SIGTERM, SIGINT}) {
    const auto child = start();
    ASSERT_TRUE(await_heartbeat("test", [&](const auto& beat) {
      return beat.state() == wire::ServiceState::Running && beat.pid() == static_cast<std::uint32_t>(child->pid());
    }));
    child->send(signal);
    EXPECT_TRUE(await_heartbeat("test", [](const auto& beat) { return beat.state() == wire::ServiceState::Stopping; }));
    EXPECT_EQ(child->wait(), 0);
  }
}

/// A supervisor knows what it asked for itself: what somebody else stopped is no end of its own will.
TEST_F(Service, UnderASupervisorASignalIsTheExitStatus) {
  ASSERT_EQ(::setenv("SPLATBUS_SUPERVISED", "1", 1), 0);
  for (const int signal : {SIGTERM, SIGINT}) {
    const auto child = start();
    EXPECT_TRUE(await_heartbeat("test", [&](const auto& beat) {
      return beat.state() == wire::ServiceState::Running && beat.pid() == static_cast<std::uint32_t>(child->pid());
    }));
    child->send(signal);
    EXPECT_EQ(child->wait(), 128 + signal);
  }
  ChildProcess broker("splatbus-bus", {"--bus", "ipc://" + directory_.path() + "/second"}, output_path());
  EXPECT_TRUE(eventually([&] { return read_text(output_path()).find("bus on") != std::string::npos; }));
  broker.send(SIGTERM);
  EXPECT_EQ(broker.wait(), 128 + SIGTERM);
  ::unsetenv("SPLATBUS_SUPERVISED");
}

/// There is nothing that another attempt would mend.
TEST_F(Service, WhatIsConfiguredWronglyEndsWithItsOwnStatus) {
  ChildProcess keyless("bus-test-service", {"--bus", "tcp://192.0.2.1:7600"}, output_path());
  EXPECT_EQ(keyless.wait(), bus::kExitPermanent);
  EXPECT_THAT(read_text(output_path()), HasSubstr("requires a key"));
}

TEST_F(Service, APortInUseIsWaitedForAndThenFinal) {
  const bus::Address held = bus::Address::parse("ipc://" + directory_.path() + "/holder");
  std::filesystem::create_directory(*held.directory);
  std::filesystem::permissions(*held.directory, std::filesystem::perms::owner_all);
  bus_service::Broker holder({.address = held, .tcp_host = "127.0.0.1", .tcp_port = 0});
  holder.start();
  ChildProcess second("splatbus-bus",
                      {"--bus", "ipc://" + directory_.path() + "/second", "--tcp",
                       "127.0.0.1:" + std::to_string(holder.tcp_address()->port)},
                      output_path());
  EXPECT_EQ(second.wait(), bus::kExitPermanent);
  EXPECT_THAT(read_text(output_path()), HasSubstr("cannot bind: Address already in use"));
}

TEST(Bind, WhatIsFreedInTimeIsNoError) {
  int attempts = 0;
  EXPECT_NO_THROW(bus::bind_patiently("port", [&] { return ++attempts < 3 ? EADDRINUSE : 0; }));
  EXPECT_EQ(attempts, 3);
  EXPECT_THROW(bus::bind_patiently("port", [] { return EADDRINUSE; }), bus::PermanentError);
  attempts = 0;
  try {
    bus::bind_patiently("port", [&] { return ++attempts, EACCES; });
    FAIL();
  } catch (const bus::PermanentError&) {
    FAIL() << "it may pass";
  } catch (const bus::Error& error) {
    EXPECT_STREQ(error.what(), "port: Permission denied");
  }
  EXPECT_EQ(attempts, 1);
}

TEST_F(Service, AFailureIsLoggedAndShown) {
  const auto child = start();
  ASSERT_TRUE(await_heartbeat("test", [](const auto& beat) { return beat.state() == wire::ServiceState::Running; }));
  control("control/test", "fail", "true");
  EXPECT_TRUE(await_log(wire::LogLevel::Error, "told to fail"));
  EXPECT_TRUE(await_heartbeat("test", [](const auto& beat) {
    return beat.state() == wire::ServiceState::Failed && beat.detail()->str() == "told to fail";
  }));
  EXPECT_EQ(child->wait(), 1);
}

TEST_F(Service, BadFlagsAreExplained) {
  const std::pair<std::vector<std::string>, const char*> cases[] = {{{"--set", "rate_hz=99"}, "from 1 to 10"},
                                                                    {{"--set", "rate_hz"}, "name=value"},
                                                                    {{"--set", "speed=1"}, "speed"},
                                                                    {{"--set", "numbr=1"}, "did you mean 'number'?"},
                                                                    {{"--backnd", "cpu"}, "did you mean '--backend'?"},
                                                                    {{"--log-level", "loud"}, "loud"}};
  for (const auto& [arguments, text] : cases) {
    const auto child = start(arguments);
    EXPECT_EQ(child->wait(), 2);
    EXPECT_THAT(read_text(output_path()), HasSubstr(text));
  }
  ChildProcess child("bus-test-service", {"--bus", "nowhere"}, output_path());
  EXPECT_EQ(child.wait(), 2);
  EXPECT_THAT(read_text(output_path()), HasSubstr("'nowhere'"));
}

TEST_F(Service, ParametersArePrintedOnDemand) {
  const auto child = start({"--parameters"});
  EXPECT_EQ(child->wait(), 0);
  EXPECT_THAT(read_text(output_path()),
              testing::AllOf(HasSubstr("rate_hz = 5"), HasSubstr("hertz (number, from 1 to 10)"),
                             HasSubstr("a name (text, fixed at start)")));
}

TEST_F(Service, TheBrokerTellsWhoIsAlive) {
  bus::Subscriber subscriber(context_, {"sys/liveness"});
  const auto state_of = [&](const std::string& source, bool alive) {
    return eventually([&] {
      const auto message = subscriber.receive(100ms);
      if (!message) return false;
      const auto* nodes = message->root<wire::Liveness>().nodes();
      return std::any_of(nodes->begin(), nodes->end(), [&](const wire::Node* node) {
        return node->source()->str() == source && node->alive() == alive && node->service()->str() == "test";
      });
    });
  };
  const auto child = start();
  EXPECT_TRUE(state_of("test", true));
  child->send(SIGKILL);
  EXPECT_TRUE(state_of("test", false));
}

}  // namespace
}  // namespace splatbus::bus_test
