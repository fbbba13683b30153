#include "bus/parameters.h"

#include <gmock/gmock.h>

#include <string>
#include <tuple>
#include <vector>

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
      {"rig", "spiral", "ring, moving"},
      {"turn_deg", "-1", "from 0"},
      {"room_mb", "-1", "from 0"},
      {"room_mb", "99999999999999999", "from 0"},
      {"camera", "3", "no parameter"}};
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
