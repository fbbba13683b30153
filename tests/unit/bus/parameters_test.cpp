#include "bus/parameters.h"

#include <gmock/gmock.h>

namespace splatbus::bus {
namespace {

using testing::HasSubstr;

Parameters make_parameters() {
  return Parameters(
      {{.name = "enabled", .default_value = false, .description = "a switch"},
       {.name = "cameras", .default_value = std::int64_t{8}, .description = "how many", .minimum = 1, .maximum = 64},
       {.name = "rate_hz", .default_value = 5.0, .description = "hertz", .minimum = 0, .maximum = 100},
       {.name = "rig",
        .default_value = std::string("ring"),
        .description = "where",
        .choices = {"ring", "moving"},
        .runtime = false}});
}

TEST(ParametersTest, DefaultsAreThere) {
  const auto parameters = make_parameters();
  EXPECT_FALSE(parameters.boolean("enabled"));
  EXPECT_EQ(parameters.integer("cameras"), 8);
  EXPECT_EQ(parameters.number("rate_hz"), 5.0);
  EXPECT_EQ(parameters.text("rig"), "ring");
  EXPECT_EQ(parameters.version(), 0u);
}

TEST(ParametersTest, GoodValuesAreTaken) {
  auto parameters = make_parameters();
  EXPECT_EQ(parameters.set("enabled", "on", true), "");
  EXPECT_EQ(parameters.set("cameras", "64", true), "");
  EXPECT_EQ(parameters.set("rate_hz", "2.5e1", true), "");
  EXPECT_EQ(parameters.set("rig", "moving", false), "");
  EXPECT_TRUE(parameters.boolean("enabled"));
  EXPECT_EQ(parameters.integer("cameras"), 64);
  EXPECT_EQ(parameters.number("rate_hz"), 25.0);
  EXPECT_EQ(parameters.text("rig"), "moving");
  EXPECT_EQ(parameters.version(), 4u);
  const std::vector<std::pair<std::string, std::string>> expected{
      {"enabled", "true"}, {"cameras", "64"}, {"rate_hz", "25"}, {"rig", "moving"}};
  EXPECT_EQ(parameters.list(), expected);
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
      {"camera", "3", "no parameter"}};
  for (const auto& [name, value, why] : refusals) {
    EXPECT_THAT(parameters.set(name, value, false), testing::AllOf(HasSubstr(name), HasSubstr(value), HasSubstr(why)));
  }
  EXPECT_EQ(parameters.version(), 0u);
  EXPECT_EQ(parameters.integer("cameras"), 8);
}

TEST(ParametersTest, WhatIsFixedAtStartStaysFixed) {
  auto parameters = make_parameters();
  EXPECT_THAT(parameters.set("rig", "moving", true), HasSubstr("while the service runs"));
  EXPECT_EQ(parameters.text("rig"), "ring");
}

}  // namespace
}  // namespace splatbus::bus
