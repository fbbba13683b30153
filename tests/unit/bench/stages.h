#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <string>

#include "bench/bench_scene.h"
#include "splats/file.h"

namespace splatbus::bench {

/// A small scene and its cameras in files.
class StagesTest : public ::testing::Test {
 protected:
  void SetUp() override {
    const std::filesystem::path folder = ::testing::TempDir();
    const std::string name = ::testing::UnitTest::GetInstance()->current_test_info()->test_suite_name();
    arguments.scene = folder / ("bench_" + name + ".ply");
    arguments.cameras = folder / ("bench_" + name + ".json");
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
    splats::write_file(arguments.scene, model.view(), {}, {.axes = splats::Axes::Keep});
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
  void expect_lines(const nlohmann::json& result) const {
    ASSERT_FALSE(result.at("stages").empty());
    for (const auto& [stage, milliseconds] : result.at("stages").items()) {
      ASSERT_TRUE(result.at("roofline").contains(stage)) << stage;
      const auto& line = result.at("roofline").at(stage);
      EXPECT_GT(line.at("floor_ms"), 0) << stage;
      EXPECT_EQ(line.at("measured_ms"), milliseconds) << stage;
    }
    EXPECT_EQ(result.at("work").at("gaussians"), 50);
    EXPECT_EQ(result.at("work").at("views"), arguments.batch);
    EXPECT_GT(result.at("work").at("evaluations"), 0);
  }

  Arguments arguments;
};

}  // namespace splatbus::bench
