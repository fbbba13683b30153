// What there is no memory for is refused before anything is lost.
#include <limits>

#include "cuda_scenes.h"
#include "raster/cuda/device_model.h"
#include "raster/cuda/pair_limit.h"
#include "raster/cuda/train_step.h"

namespace splatbus::raster::testing {
namespace {

TEST_F(CudaTest, AWorkspaceThatCannotGrowStaysAsItIs) {
  cuda::Workspace workspace;
  const cuda::WorkspaceRequest small{.count = 100, .batch = 2, .width = 64, .height = 48, .pair_capacity = 1000};
  workspace.reserve(small);
  const std::size_t bytes = workspace.bytes();
  const float* const color = workspace.view().color;
  // 150 GB at least; and pixels of which there are too many whatever memory there is.
  const cuda::WorkspaceRequest memory{
      .count = 1 << 23, .batch = 16, .width = 8192, .height = 8192, .albedo = true, .pair_capacity = cuda::kMostPairs};
  const cuda::WorkspaceRequest pixels{.count = 1, .batch = 2, .width = 32768, .height = 32768, .training = false};
  for (const cuda::WorkspaceRequest& request : {memory, pixels}) {
    EXPECT_THROW(workspace.require(request), cuda::StepTooLarge);
    EXPECT_THROW(workspace.reserve(request), cuda::StepTooLarge);
    EXPECT_EQ(workspace.bytes(), bytes);
    EXPECT_EQ(workspace.view().color, color);
  }
  EXPECT_FALSE(workspace.reserve(small));
}

TEST_F(CudaTest, AGroupThatIsTooLargeLeavesTheOthers) {
  const Case c{"", {Appearance::Radiance, 0}, 200, 32, 24, true, false, -2.0F};
  const GaussiansBuffer model = random_model(c, 3);
  const SceneState scene = random_scene(false);
  const std::vector<std::uint8_t> target(std::size_t{4} * c.width * c.height, 90);
  device::Buffer<std::uint8_t> picture;
  picture.upload(target.data(), target.size(), nullptr);
  cuda::DeviceModel device;
  device.upload(model.view(), nullptr);
  cudaDeviceSynchronize();
  cuda::TrainStep train({});
  train.set_model(device.view());
  train.set_learning_rates(std::vector<float>(14, 1e-3F));
  const auto view = [&](std::uint32_t width, std::uint32_t height) {
    return cuda::TrainView{{look_at({0.5F, 1.5F, 5.0F}, {0, 0, 0}, width, height, 1.0F), &scene}, picture.data()};
  };
  const cuda::TrainView small = view(c.width, c.height);
  const std::size_t group = train.add_group({&small, 1});
  train.step(group);
  train.step(group);
  const std::size_t bytes = train.bytes();
  const std::vector<cuda::TrainView> large(16, view(16384, 8192));
  EXPECT_THROW(train.add_group(large), cuda::StepTooLarge);
  EXPECT_EQ(train.bytes(), bytes);
  train.step(group);
  const auto reports = train.finished(true);
  ASSERT_EQ(reports.size(), 3U);
  EXPECT_LT(reports[2].loss, reports[0].loss);
  EXPECT_NE(train.color(), nullptr);
  train.clear_groups();
  EXPECT_EQ(train.workspace().pair_count, nullptr);
}

TEST_F(CudaTest, ARefusedStepLeavesNoArraysToReadFrom) {
  const Case c{"", {Appearance::Radiance, 0}, 200, 32, 24, true, false, -2.0F};
  const GaussiansBuffer model = random_model(c, 3);
  const SceneState scene = random_scene(false);
  cuda::DeviceModel device;
  device.upload(model.view(), nullptr);
  cudaDeviceSynchronize();
  cuda::TrainStep draw({.training = false});
  draw.set_model(device.view());
  const Camera camera = look_at({0.5F, 1.5F, 5.0F}, {0, 0, 0}, c.width, c.height, 1.0F);
  const std::size_t group = draw.add_group(std::vector<cuda::TrainView>(16, {{camera, &scene}}));
  draw.forward(group);
  EXPECT_EQ(draw.workspace().batch, 16);
  cuda::DeviceGaussians vast = device.view();
  vast.stride = std::numeric_limits<int>::max();  // a terabyte of records
  draw.follow_model(vast);
  EXPECT_THROW(draw.forward(group), cuda::StepTooLarge);
  EXPECT_EQ(draw.workspace().batch, 0);
  EXPECT_EQ(draw.color(), nullptr);
  draw.follow_model(device.view());
  draw.forward(group);
  EXPECT_EQ(draw.workspace().batch, 16);
  EXPECT_NE(draw.color(), nullptr);
}

}  // namespace
}  // namespace splatbus::raster::testing
