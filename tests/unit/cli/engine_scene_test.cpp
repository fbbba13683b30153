#include "engine_scene.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace splatbus::cli {
namespace {

using testing::ElementsAre;

constexpr const char* kLaunchFile = R"(
services:
  - name: bus
  - name: engine
    args: [--sun-rate, "6", --dynamics, --fps, "12", --sun-zenith, "30"]
  - name: capture-bridge
    parameters: {reference_rate_hz: 2}
)";

TEST(EngineScene, StillTakesOutWhatMoves) {
  LaunchFile file = parse_launch_file(kLaunchFile, "x.yaml");
  apply({.reference_rate_hz = 0.5}, file);
  EXPECT_THAT(file.find("engine")->args,
              ElementsAre("--fps", "12", "--sun-zenith", "30", "--sun-rate", "0", "--point-lights", "0"));
  EXPECT_EQ(file.find("capture-bridge")->parameters.at("reference_rate_hz").value, "0.5");
}

TEST(EngineScene, LivingSetsEachFlagOnce) {
  LaunchFile file = parse_launch_file(kLaunchFile, "x.yaml");
  apply({.moving_objects = true, .sun_rate_deg_s = 15, .fps = 30, .reference_rate_hz = 10}, file);
  EXPECT_THAT(file.find("engine")->args, ElementsAre("--sun-zenith", "30", "--fps", "30", "--sun-rate", "15",
                                                     "--point-lights", "0", "--dynamics"));
  EXPECT_EQ(file.find("capture-bridge")->parameters.at("reference_rate_hz").value, "10");
}

TEST(EngineScene, PointLightsShineAtNight) {
  LaunchFile file = parse_launch_file(kLaunchFile, "x.yaml");
  apply({.point_lights = 3}, file);
  EXPECT_THAT(file.find("engine")->args,
              ElementsAre("--fps", "12", "--sun-zenith", "30", "--sun-rate", "0", "--point-lights", "3", "--night"));
}

TEST(EngineScene, AFileWithoutEngineIsRefused) {
  LaunchFile file = parse_launch_file("services:\n  - name: bus\n", "x.yaml");
  EXPECT_THROW(apply({}, file), LaunchError);
}

}  // namespace
}  // namespace splatbus::cli
