#include "node_info.h"

#include <gmock/gmock.h>

#include <algorithm>
#include <fstream>

#include "../bus/bus_fixture.h"
#include "child_process.h"
#include "control_socket.h"
#include "run_verb.h"
#include "wire/topics.h"

namespace splatbus::cli {
namespace {

using Json = nlohmann::json;
using testing::HasSubstr;

class NodeInfoVerb : public bus_test::BusTest {
 protected:
  std::string run(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), {"node", "info", "--bus", directory_.address().text()});
    return run_verb(add_node_verb, std::move(arguments));
  }
  void start(const std::string& name) {
    const std::string program = std::string(SPLATBUS_BIN_DIR) + "/bus-test-service";
    services_.emplace_back(program, std::vector<std::string>{"--bus", directory_.address().text(), "--name", name},
                           std::map<std::string, std::string>());
    BusWatch watch(connect("tester"));
    ASSERT_TRUE(bus_test::eventually([&] {
      watch.follow(std::chrono::milliseconds(20));
      const auto found = watch.nodes().find(name);
      if (found == watch.nodes().end() || found->second.state != "Running" || !watch.topics()) return false;
      const auto topic = watch.topics()->topics.find("test/model");
      const auto control = watch.topics()->topics.find("sys/heartbeat");
      return topic != watch.topics()->topics.end() && topic->second.sources.contains(name) &&
             control != watch.topics()->topics.end();
    }));
  }
  std::vector<ChildProcess> services_;
};

TEST_F(NodeInfoVerb, ShowsWhatAProcessDoesAndUses) {
  start("test-1");
  const bus::Subscriber reader(connect("reader"), {"test/*"});
  const Json info = Json::parse(run({"test-1", "--json"}));
  EXPECT_EQ(info["source"], "test-1");
  EXPECT_EQ(info["kind"], "test");
  EXPECT_EQ(info["state"], "Running");
  EXPECT_EQ(info["alive"], true);
  EXPECT_EQ(info["backend"], "cpu");
  EXPECT_EQ(info["protocol"], kProtocolVersion);
  EXPECT_EQ(info["parameters"]["rate_hz"], "5");
  EXPECT_TRUE(info["counters"].contains("turns"));
  EXPECT_TRUE(info["restarts"].is_null()) << "there is no supervisor";
  EXPECT_GT(info["memory_bytes"], 1 << 20);
  EXPECT_GE(info["processor_s"], 0);
  const auto publishes = [&](const std::string& topic) {
    return std::any_of(info["publishes"].begin(), info["publishes"].end(),
                       [&](const Json& entry) { return entry["topic"] == topic && !entry["schemas"].empty(); });
  };
  EXPECT_TRUE(publishes("test/model"));
  EXPECT_TRUE(publishes("sys/heartbeat"));
  EXPECT_FALSE(publishes("sys/topics")) << "is the broker's";

  const std::string text = run({"test"});
  const std::string protocol = "protocol    " + std::to_string(kProtocolVersion) + "\n";
  for (const char* part : {"test-1 (test)\n", "state       Running: counting\n", "backend     cpu\n", protocol.c_str(),
                           "    rate_hz                  5\n", "    test/model               ViewerProbe/1"}) {
    EXPECT_THAT(text, HasSubstr(part));
  }
}

TEST_F(NodeInfoVerb, ShowsWhatItReads) {
  start("test-1");
  // A topic exists with its first message.
  bus::Publisher publisher(connect("tester"));
  publisher.publish(topics::control("control/test-1"),
                    [](auto& builder, auto header) { return wire::CreateControl(builder, header); });
  ASSERT_TRUE(bus_test::eventually([&] {
    const Json info = Json::parse(run({"test-1", "--json"}));
    return std::any_of(info["subscribes"].begin(), info["subscribes"].end(), [](const Json& entry) {
      return entry["topic"] == "control/test-1" && entry["publishers"] == Json({"tester"});
    });
  }));
}

TEST_F(NodeInfoVerb, SaysWhatThereIsWhenThereIsNoSuchName) {
  start("test-1");
  try {
    static_cast<void>(run({"tset-1"}));
    ADD_FAILURE();
  } catch (const std::runtime_error& error) {
    EXPECT_STREQ(error.what(), "no process 'tset-1' on this bus; did you mean 'test-1'?");
  }
  start("test-2");
  try {
    static_cast<void>(run({"test"}));
    ADD_FAILURE();
  } catch (const std::runtime_error& error) {
    EXPECT_STREQ(error.what(), "several processes are of kind 'test' on this bus (known: test-1, test-2)");
  }
  EXPECT_THAT(run({"test-2"}), HasSubstr("test-2 (test)"));
}

/// What the bus says is shown, whatever becomes of the supervisor.
TEST_F(NodeInfoVerb, DoesWithoutASupervisorThatSaysNothing) {
  start("test-1");
  const ControlListener mute(directory_.address());
  EXPECT_TRUE(Json::parse(run({"test-1", "--json"}))["restarts"].is_null());
}

/// A launch file with an argument that has to be given.
TEST_F(NodeInfoVerb, WaitsForTheServicesOfAFileWithArguments) {
  start("test-1");
  const std::string file = directory_.path() + "/wait.yaml";
  std::ofstream(file) << "arguments: {who: {type: text}}\nservices:\n  - {name: bus}\n"
                         "  - {name: \"${who}\", program: ./t}\n";
  const std::vector<std::string> wait{"node",   "list", "--bus",     directory_.address().text(),
                                      "--wait", file,   "--timeout", "60"};
  auto with = wait;
  with.emplace_back("who=test-1");
  EXPECT_THAT(run_verb(add_node_verb, with), HasSubstr("test-1"));
  EXPECT_THROW(run_verb(add_node_verb, wait), std::runtime_error);
}

}  // namespace
}  // namespace splatbus::cli
