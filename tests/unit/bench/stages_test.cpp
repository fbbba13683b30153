#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>

#include "bench/bench_scene.h"

namespace splatbus::bench {
namespace {

/// A small scene and its cameras in files.
class Stages : public ::testing::Test {
 protected:
  void SetUp() override {
    const std::filesystem::path folder = ::testing::TempDir();
    arguments.scene = folder / "bench_stages.ply";
    arguments.cameras = folder / "bench_stages.json";
    GaussiansBuffer model({Appearance::Radiance, 1}, 50);
    for (std::size_t i = 0; i < model.count(); ++i) {
      const auto set = [&](std::size_t channel, float value) {
        model.parameters[channel * model.stride() + i] = value;
      };
      set(0, 0.02F * static_cast<float>(i) - 0.5F);
      set(1, 0.1F * static_cast<float>(i % 7) - 0.3F);
      set(2, 2);
      for (std::size_t c = 3; c < 6; ++c) set(c, std::log(0.05F));
      set(6, 1);
      set(10, 1);
    }
    write_ply(arguments.scene, model.view(), {});
    const nlohmann::json pose = {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}};
    const nlohmann::json intrinsics = {{40, 0, 16}, {0, 40, 16}, {0, 0, 1}};
    std::ofstream(arguments.cameras) << nlohmann::json{
        {"width", 32}, {"height", 32}, {"world_to_camera", {pose, pose}}, {"intrinsics", {intrinsics, intrinsics}}};
    arguments.sh = 1;
    arguments.iterations = 2;
    arguments.warmup = 1;
  }
  void TearDown() override {
    std::filesystem::remove(arguments.scene);
    std::filesystem::remove(arguments.cameras);
  }

  /// Every stage has a line of the roofline, and something to do.
  void expect_lines() const {
    const nlohmann::json result = run_cpu(arguments);
    ASSERT_FALSE(result.at("stages").empty());
    for (const auto& [stage, milliseconds] : result.at("stages").items()) {
      ASSERT_TRUE(result.at("roofline").contains(stage)) << stage;
      EXPECT_GT(result["roofline"][stage]["floor_ms"], 0) << stage;
      EXPECT_EQ(result["roofline"][stage]["measured_ms"], milliseconds) << stage;
    }
    EXPECT_EQ(result.at("work").at("gaussians"), 50);
    EXPECT_EQ(result["work"]["views"], arguments.batch);
    EXPECT_GT(result["work"]["evaluations"], 0);
  }

  Arguments arguments;
};

TEST_F(Stages, OfTrainingWithAdamInTheBackwardPassHaveFloors) {
  expect_lines();
}

TEST_F(Stages, OfTrainingABatchHaveFloors) {
  arguments.batch = 2;
  expect_lines();
}

TEST_F(Stages, OfTransferHaveFloors) {
  arguments.appearance = "transfer";
  expect_lines();
}

TEST_F(Stages, OfForwardHaveFloors) {
  arguments.mode = "forward";
  expect_lines();
}

}  // namespace
}  // namespace splatbus::bench
