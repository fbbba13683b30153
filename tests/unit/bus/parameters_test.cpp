#include "bus/parameters.h"

#include <gmock/gmock.h>

#include <string>
#include <tuple>
#include <vector>

#include "bus/error.h"
#include "bus/nearest.h"
#include "bus/parameter_json.h"
#include "wire/system_generated.h"

namespace splatbus::bus {
namespace {

using testing::HasSubstr;

enum class Rig { Ring, Moving };

struct Options {
  bool enabled = false;
  int cameras = 8;
  float rate_hz = 5.2F;
  Rig rig = Rig::Ring;
  std::string target = "here";
  float turn_radians = 1.0471976F;
  std::size_t room_bytes = std::size_t{3} << 20;

  void bind(ParameterBinder& p) {
    p.add("enabled", enabled, "a switch");
    p.add("cameras", cameras, "how many", {1, 64});
    p.add("rate_hz", rate_hz, "hertz", {0, 100});
    p.add("rig", rig, "where", {{"ring", Rig::Ring}, {"moving", Rig::Moving}}, kFixed);
    p.add("target", target, "what");
    p.add("turn_deg", turn_radians, "degrees", {.minimum = 0}, kRuntime, kDegrees);
    p.add("room_mb", room_bytes, "MiB", {}, kRuntime, kMebibytes);
  }
};

Parameters make_parameters() {
  return Parameters(Parameters::declare<Options>());
}

TEST(ParametersTest, DefaultsAreThere) {
  const auto parameters = make_parameters();
  const std::vector<std::pair<std::string, std::string>> expected{
      {"enabled", "false"}, {"cameras", "8"},   {"rate_hz", "5.2"}, {"rig", "ring"},
      {"target", "here"},   {"turn_deg", "60"}, {"room_mb", "3"}};
  EXPECT_EQ(parameters.list(), expected);
  EXPECT_EQ(parameters.version(), 0u);
  const auto options = parameters.read<Options>();
  EXPECT_EQ(options.rate_hz, 5.2F);
  EXPECT_EQ(options.rig, Rig::Ring);
  EXPECT_FLOAT_EQ(options.turn_radians, 1.0471976F);
  EXPECT_EQ(options.room_bytes, std::size_t{3} << 20);
}

TEST(ParametersTest, GoodValuesAreTaken) {
  auto parameters = make_parameters();
  EXPECT_EQ(parameters.set("enabled", "on", true), "");
  EXPECT_EQ(parameters.set("cameras", "64", true), "");
  EXPECT_EQ(parameters.set("rate_hz", "2.5e1", true), "");
  EXPECT_EQ(parameters.set("rig", "moving", false), "");
  EXPECT_EQ(parameters.set("target", "", true), "");
  EXPECT_EQ(parameters.set("turn_deg", "90", true), "");
  EXPECT_EQ(parameters.set("room_mb", "5", true), "");
  EXPECT_EQ(parameters.version(), 7u);
  const auto options = parameters.read<Options>();
  EXPECT_TRUE(options.enabled);
  EXPECT_EQ(options.cameras, 64);
  EXPECT_EQ(options.rate_hz, 25.0F);
  EXPECT_EQ(options.rig, Rig::Moving);
  EXPECT_EQ(options.target, "");
  EXPECT_FLOAT_EQ(options.turn_radians, 1.5707964F);
  EXPECT_EQ(options.room_bytes, std::size_t{5} << 20);
}

TEST(ParametersTest, BadValuesAreRefusedByNameAndChangeNothing) {
  auto parameters = make_parameters();
  const std::tuple<const char*, const char*, const char*> refusals[] = {
      {"enabled", "maybe", "true or false"},
      {"cameras", "0", "from 1 to 64"},
      {"cameras", "65", "from 1 to 64"},
      {"cameras", "8.5", "whole number"},
      {"cameras", "", "whole number"},
      {"cameras", "8x", "whole number"},
      {"cameras", "99999999999999999999", "whole number"},
      {"rate_hz", "nan", "a number"},
      {"rate_hz", "inf", "a number"},
      {"rate_hz", "-1", "from 0 to 100"},
      {"rate_hz", "5 ", "a number"},
      {"rig", "spiral", "ring or moving"},
      {"turn_deg", "-1", "at least 0"},
      {"room_mb", "-1", "from 0"},
      {"room_mb", "99999999999999999", "from 0"},
      {"camera", "3", "did you mean 'cameras'?"}};
  for (const auto& [name, value, why] : refusals) {
    EXPECT_THAT(parameters.set(name, value, false), testing::AllOf(HasSubstr(name), HasSubstr(value), HasSubstr(why)));
  }
  EXPECT_EQ(parameters.version(), 0u);
  EXPECT_EQ(parameters.read<Options>().cameras, 8);
}

TEST(ParametersTest, WhatIsFixedAtStartStaysFixed) {
  auto parameters = make_parameters();
  EXPECT_THAT(parameters.set("rig", "moving", true), HasSubstr("while the service runs"));
  EXPECT_EQ(parameters.read<Options>().rig, Rig::Ring);
}

TEST(ParametersTest, TextsKeepToTheirRule) {
  struct Connection {
    std::string endpoint, viewer;
    void bind(ParameterBinder& p) {
      p.add("endpoint", endpoint, "where", endpoint_rule());
      p.add("viewer", viewer, "where", viewer_endpoint_rule(), kFixed);
    }
  };
  Parameters parameters(Parameters::declare<Connection>());
  for (const char* good : {"", "tcp://*:7600", "tcp://127.0.0.1:*", "tcp://[::1]:5", "ipc:///tmp/x"}) {
    EXPECT_EQ(parameters.set("endpoint", good, true), "") << good;
  }
  for (const char* bad : {"tcp:/*:7600", "7600", "127.0.0.1:7999", "tcp://:7600", "tcp://a:70000", "tcp://a:1x",
                          "tcp://a/b:1", "ipc://", "wss://host:1"}) {
    EXPECT_THAT(parameters.set("endpoint", bad, true), HasSubstr("must be an endpoint such as tcp://HOST:PORT")) << bad;
  }
  EXPECT_EQ(parameters.set("viewer", "wss://host:7680", false), "");
  EXPECT_NE(parameters.set("viewer", "wss://", false), "");
  EXPECT_EQ(parameters.read<Connection>().endpoint, "ipc:///tmp/x");
}

TEST(ParametersTest, TypesAreSaidAsDeclaredAndReadBack) {
  using wire::ValueType;
  EXPECT_EQ(value_type({"a", true, "", {}, {}}), ValueType::Boolean);
  EXPECT_EQ(value_type({"a", std::int64_t{4}, "", {}, {}}), ValueType::Integer);
  EXPECT_EQ(value_type({"a", 4.0, "", {}, {}}), ValueType::Number);
  EXPECT_EQ(value_type({"a", std::string("4"), "", {}, {}}), ValueType::Text);
  EXPECT_EQ(value_type({"a", std::string("4"), "", {}, {"4", "8"}}), ValueType::Choice);
  EXPECT_EQ(typed_value("true", ValueType::Boolean), ParameterValue(true));
  EXPECT_EQ(typed_value("4", ValueType::Integer), ParameterValue(std::int64_t{4}));
  EXPECT_EQ(typed_value("4", ValueType::Number), ParameterValue(4.0));
  EXPECT_EQ(typed_value("1e-05", ValueType::Number), ParameterValue(1e-5));
  for (const auto type : {ValueType::Text, ValueType::Choice, ValueType::Unsaid}) {
    EXPECT_EQ(typed_value("4", type), ParameterValue(std::string("4")));
  }
  // Whoever says so: it is not what it is said to be.
  EXPECT_EQ(typed_value("4x", ValueType::Integer), ParameterValue(std::string("4x")));
  EXPECT_EQ(typed_value("nan", ValueType::Number), ParameterValue(std::string("nan")));
  EXPECT_EQ(typed_value("4", ValueType::Boolean), ParameterValue(std::string("4")));
  EXPECT_EQ(typed_value("4", static_cast<ValueType>(99)), ParameterValue(std::string("4")));
}

TEST(ParametersTest, AReportGoesThroughJsonWhole) {
  auto parameters = make_parameters();
  ASSERT_EQ(parameters.set("cameras", "9", false), "");
  const auto report = parse_parameter_report(to_json({describe(parameters), {{"rig", "it \"spins\""}}}));
  ASSERT_EQ(report.parameters.size(), 7u);
  const auto& cameras = report.parameters.at(1);
  EXPECT_EQ(cameras.name, "cameras");
  EXPECT_EQ(cameras.type, "integer");
  EXPECT_EQ(cameras.bounds, "from 1 to 64");
  EXPECT_EQ(cameras.default_value, "8");
  EXPECT_EQ(cameras.value, "9");
  EXPECT_EQ(cameras.text, "how many");
  EXPECT_FALSE(cameras.at_start);
  EXPECT_EQ(report.parameters.at(3).bounds, "ring or moving");
  EXPECT_EQ(report.parameters.at(3).type, "choice");
  EXPECT_TRUE(report.parameters.at(3).at_start);
  ASSERT_EQ(report.problems.size(), 1u);
  EXPECT_EQ(report.problems.at(0).text, "it \"spins\"");
  for (const char* bad : {"", "{}", "[]", "{\"parameters\": 3, \"problems\": []}"}) {
    EXPECT_THROW(static_cast<void>(parse_parameter_report(bad)), Error) << bad;
  }
}

TEST(Nearest, IsWhatWasMeant) {
  const std::vector<std::string> known{"launch", "export", "engine", "capture-bridge", "set"};
  EXPECT_EQ(nearest("lunch", known), "launch");
  EXPECT_EQ(nearest("luanch", known), "launch") << "a swap is one mistake";
  EXPECT_EQ(nearest("LAUNCH", known), "launch");
  EXPECT_EQ(nearest("engin", known), "engine");
  EXPECT_EQ(nearest("capturebridge", known), "capture-bridge");
  EXPECT_EQ(nearest("ste", known), "set");
  EXPECT_EQ(nearest("viewer", known), "");
  EXPECT_EQ(nearest("", known), "");
  EXPECT_EQ(nearest(std::string(100000, 'x'), known), "");
  EXPECT_EQ(suggestion("engin", known), "; did you mean 'engine'?");
  EXPECT_EQ(suggestion("zzz", {"a", "b"}), " (known: a, b)");
  EXPECT_EQ(suggestion("zzz", {}), "");
}

TEST(ParametersTest, LiveOptionsChangeWhenTheyAreRenewed) {
  auto parameters = make_parameters();
  LiveOptions<Options> options(parameters);
  EXPECT_FALSE(options.refresh());
  EXPECT_EQ(parameters.set("cameras", "9", true), "");
  EXPECT_EQ(options->cameras, 8);
  EXPECT_TRUE(options.refresh());
  EXPECT_EQ(options->cameras, 9);
  EXPECT_FALSE(options.refresh());
}

}  // namespace
}  // namespace splatbus::bus
