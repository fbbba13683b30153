#include <gmock/gmock.h>

#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "../bus/bus_fixture.h"
#include "child_process.h"
#include "control_server.h"
#include "parameter_query.h"
#include "run_verb.h"

namespace splatbus::cli {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

/// A bus with a service on it, and the verb as a user gives it.
class ParamVerb : public bus_test::BusTest {
 protected:
  std::string run(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), "param");
    arguments.insert(arguments.begin() + 2, {"--bus", directory_.address().text()});
    return run_verb(add_param_verb, std::move(arguments));
  }
  std::string error_of(std::vector<std::string> arguments) {
    try {
      return "no error, but: " + run(std::move(arguments));
    } catch (const std::exception& error) {
      return error.what();
    }
  }
  void start(const std::string& name, const std::vector<std::string>& more = {}) {
    std::vector<std::string> arguments{"--bus", directory_.address().text(), "--name", name};
    arguments.insert(arguments.end(), more.begin(), more.end());
    services_.emplace_back(std::string(SPLATBUS_BIN_DIR) + "/bus-test-service", arguments, environment_);
    const auto context = connect("tester");
    ASSERT_TRUE(bus_test::eventually([&] {
      try {
        return !find_owners(context, name).empty();
      } catch (const std::runtime_error&) {
        return false;
      }
    }));
  }

  std::map<std::string, std::string> environment_;
  std::vector<ChildProcess> services_;
};

TEST_F(ParamVerb, ListsGetsAndSets) {
  start("test-1");
  EXPECT_THAT(run({"list", "test"}), HasSubstr("test-1.number = 7\n"));
  EXPECT_EQ(run({"get", "test-1", "rate_hz"}), "5\n");
  EXPECT_EQ(run({"set", "test-1", "rate_hz", "8.50"}), "test-1.rate_hz = 8.5 (was 5)\n");
  EXPECT_EQ(run({"get", "test-1", "rate_hz"}), "8.5\n");
  EXPECT_EQ(run({"set", "test", "rate_hz", "8.5"}), "test-1.rate_hz = 8.5 (was 8.5)\n") << "by kind, and once more";
  const auto json = nlohmann::json::parse(run({"set", "test", "number", "9", "--json"}));
  EXPECT_EQ(json.at("value"), 9);
  EXPECT_EQ(json.at("before"), 7);
}

TEST_F(ParamVerb, JsonHasValuesOfTheDeclaredTypes) {
  using nlohmann::json;
  start("test-1");
  const auto value = [&](const char* key) { return json::parse(run({"get", "test-1", key, "--json"})).at("value"); };
  EXPECT_TRUE(value("number").is_number_integer());
  EXPECT_EQ(value("fail"), false);
  EXPECT_EQ(value("rate_hz"), 5);
  EXPECT_TRUE(value("rate_hz").is_number_float()) << "a number, though it reads like a whole one";
  EXPECT_EQ(value("fixed"), "a");
  run({"set", "test-1", "number", "8"});
  std::istringstream lines(run({"list", "test-1", "--json"}));
  std::map<std::string, json> listed;
  for (std::string line; std::getline(lines, line);) {
    const json one = json::parse(line);
    listed[one.at("name")] = one;
  }
  EXPECT_EQ(listed.at("number").at("value"), 8);
  EXPECT_EQ(listed.at("fail").at("value"), false);
}

TEST_F(ParamVerb, RefusalsAreTheServicesOwnAndTheNearestNames) {
  start("test-1");
  EXPECT_THAT(error_of({"set", "test-1", "rate_hz", "99"}), HasSubstr("must be a number from 1 to 10, not '99'"));
  EXPECT_THAT(error_of({"set", "test-1", "fixed", "b"}), HasSubstr("is fixed while the service runs"));
  EXPECT_THAT(error_of({"set", "test-1", "numbr", "1"}), HasSubstr("did you mean 'number'?"));
  EXPECT_THAT(error_of({"get", "test-1", "numbr"}), HasSubstr("did you mean 'number'?"));
  EXPECT_THAT(error_of({"get", "tset-1", "number"}), HasSubstr("no service 'tset-1'"));
  EXPECT_THAT(error_of({"get", "tset-1", "number"}), HasSubstr("did you mean 'test-1'?"));
  EXPECT_EQ(run({"get", "test-1", "rate_hz"}), "5\n");
  broker_->stop();
  EXPECT_THAT(error_of({"list"}), HasSubstr("no bus at "));
}

TEST_F(ParamVerb, AServiceThatLogsNothingAnswersByItsHeartbeat) {
  start("quiet", {"--log-level", "off"});
  EXPECT_EQ(run({"set", "quiet", "number", "8"}), "quiet.number = 8 (was 7)\n");
  EXPECT_EQ(run({"set", "quiet", "number", "8"}), "quiet.number = 8 (was 8)\n");
}

TEST_F(ParamVerb, SavesToTheFileThatItWasStartedFrom) {
  const std::string file = directory_.path() + "/test.yaml";
  std::ofstream(file) << "services:\n  - name: test  # mine\n    program: ./t\n";
  environment_ = {{"SPLATBUS_LAUNCH_FILE", file}, {"SPLATBUS_LAUNCH_SERVICE", "test"}};
  start("test-1");
  EXPECT_THAT(run({"set", "test-1", "number", "8", "--save"}), HasSubstr("saved in " + file));
  std::ifstream stream(file);
  EXPECT_EQ(std::string(std::istreambuf_iterator<char>(stream), {}),
            "services:\n  - name: test  # mine\n    program: ./t\n    parameters:\n      number: 8\n");
  environment_ = {};
  start("alone");
  EXPECT_THAT(error_of({"set", "alone", "number", "8", "--save"}), HasSubstr("name one with --file"));
}

/// A kind may have several entries, each with its line; the supervisor is told of each.
TEST_F(ParamVerb, SavesForEveryEntryOfAKind) {
  const std::string file = directory_.path() + "/test.yaml";
  std::ofstream(file) << "services:\n  - name: near\n    program: ./t\n  - name: far\n    program: ./t\n"
                         "    parameters: {number: 1}  # of old\n";
  environment_ = {{"SPLATBUS_LAUNCH_FILE", file}, {"SPLATBUS_LAUNCH_SERVICE", "near"}};
  start("near");
  environment_["SPLATBUS_LAUNCH_SERVICE"] = "far";
  start("far-1");
  start("far-2");
  std::vector<std::string> told;
  ControlServer supervisor(directory_.address());
  supervisor.handle("save", [&](const nlohmann::json& request, const auto&, const auto&) {
    told.push_back(request.at("service"));
    return nlohmann::json::object();
  });
  supervisor.start();
  EXPECT_THAT(run({"set", "test", "number", "8", "--save"}), HasSubstr("saved in " + file + ", for far and near"));
  std::ifstream stream(file);
  EXPECT_EQ(std::string(std::istreambuf_iterator<char>(stream), {}),
            "services:\n  - name: near\n    program: ./t\n    parameters:\n      number: 8\n  - name: far\n"
            "    program: ./t\n    parameters: {number: 8}  # of old\n");
  EXPECT_THAT(told, testing::UnorderedElementsAre("near", "far"));
}

TEST_F(ParamVerb, SavesNothingWhereOneEntryCannotHaveIt) {
  const std::string file = directory_.path() + "/test.yaml";
  const std::string text =
      "services:\n  - {name: a, program: ./t}\n  - {name: b, program: ./t, parameters: &all [1]}\n";
  std::ofstream(file) << text;
  for (const char* name : {"a", "b"}) {
    environment_ = {{"SPLATBUS_LAUNCH_FILE", file}, {"SPLATBUS_LAUNCH_SERVICE", name}};
    start(name);
  }
  EXPECT_THAT(error_of({"set", "test", "number", "8", "--save"}), HasSubstr("they are not a map"));
  std::ifstream stream(file);
  EXPECT_EQ(std::string(std::istreambuf_iterator<char>(stream), {}), text);
}

TEST(ParameterProgram, IsAskedWithTheChanges) {
  const bus_test::TemporaryDirectory folder;
  const fs::path program = fs::path(folder.path()) / "splatbus-toy";
  std::ofstream(program)
      << "#!/bin/sh\necho '{\"parameters\": [], \"problems\": [{\"parameter\": \"a\", \"text\": \"'$*'\"}]}'\n";
  fs::permissions(program, fs::perms::owner_all);
  const auto report = ask_program("toy", {{"a", "1"}}, folder.path());
  ASSERT_TRUE(report.has_value());
  EXPECT_EQ(report->problems.at(0).text, "--set a=1 --parameters --json");
  EXPECT_FALSE(ask_program("other", {}, folder.path()).has_value());
  EXPECT_FALSE(ask_program("../splatbus-toy", {}, folder.path()).has_value()) << "a name from the bus is no path";
}

}  // namespace
}  // namespace splatbus::cli
