// The training step on the device against the CPU backend and its Adam.
#include "raster/cuda/train_step.h"

#include "../raster/lights.h"
#include "cuda_scenes.h"
#include "raster/adam.h"
#include "raster/cuda/device_model.h"
#include "raster/loss.h"

namespace splatbus::raster::testing {
namespace {

TEST_F(CudaTest, TrainStepFollowsTheCpuOptimizer) {
  const Case c{"", {Appearance::Transfer, 0}, 800, 64, 56, true, true, -2.5F};
  GaussiansBuffer model = random_model(c, 3);
  const SceneState scene = random_scene(true);
  std::vector<Camera> cameras;
  for (int k = 0; k < 3; ++k) {
    const float angle = 2.0F * static_cast<float>(k);
    cameras.push_back(look_at({5 * std::cos(angle), 1.5F, 5 * std::sin(angle)}, {0, 0, 0}, c.width, c.height, 1.0F));
  }
  std::mt19937 random(17);
  std::vector<std::vector<std::uint8_t>> targets(3, std::vector<std::uint8_t>(std::size_t{4} * c.width * c.height));
  for (auto& target : targets) {
    for (auto& value : target) value = static_cast<std::uint8_t>(random() % 256);
  }
  std::vector<std::uint8_t> mask(std::size_t{c.width} * c.height);  // of the second view
  for (std::size_t i = 0; i < mask.size(); ++i) mask[i] = i / 7 % 3 == 0 ? 1 : 0;
  const std::vector<float> rates(41, 1e-3F);
  constexpr int kManySteps = 6;

  cuda::DeviceModel device;
  device.upload(model.view(), nullptr);
  cuda::TrainStep trainer({.albedo_weight = 0.5F, .lr_half_life_steps = 3});
  trainer.set_model(device.view());
  trainer.set_learning_rates(rates);
  std::vector<device::Buffer<std::uint8_t>> pictures(3);
  std::vector<cuda::TrainView> views;
  for (std::size_t k = 0; k < 3; ++k) {
    pictures[k].upload(targets[k].data(), targets[k].size(), nullptr);
    views.push_back({{cameras[k], &scene}, pictures[k].data(), pictures[k].data()});
  }
  device::Buffer<std::uint8_t> device_mask;
  device_mask.upload(mask.data(), mask.size(), nullptr);
  views[1].mask = device_mask.data();
  cudaDeviceSynchronize();
  for (int k = 0; k < kManySteps; ++k) trainer.step(views);
  const std::vector<float> gpu_losses = trainer.losses();
  std::vector<float> trained(41 * model.count());
  device.download_parameters(trained.data(), trainer.stream());
  cudaStreamSynchronize(trainer.stream());

  const auto cpu = make_cpu_rasterizer(2);
  Adam adam;
  adam.lr_half_life_steps = 3;
  adam.resize(c.layout, model.count());
  float loss = 0;
  for (int step = 0; step < kManySteps; ++step) {
    ParameterGradient gradient;
    gradient.clear(model.view());
    loss = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      Render out;
      cpu->forward(model.view(), cameras[k], scene, {.albedo = true}, out);
      RenderGradient g;
      const LossOptions options{.mask = k == 1 ? mask.data() : nullptr};
      loss += image_loss(out.color, targets[k].data(), options, g.color) / 3;
      loss += 0.5F * image_loss(out.albedo, targets[k].data(), options, g.albedo) / 3;
      for (float& value : g.color.data) value /= 3;
      for (float& value : g.albedo.data) value *= 0.5F / 3;
      cpu->backward(g, gradient);
    }
    adam.step(model.view(), model.parameters.data(), gradient, rates, 2);
  }
  double gpu_loss = 0;
  for (const float value : gpu_losses) gpu_loss += value;
  EXPECT_NEAR(gpu_loss, loss, 2e-4);
  double difference = 0, norm = 0;
  for (std::size_t channel = 0; channel < 14; ++channel) {
    for (std::size_t i = 0; i < model.count(); ++i) {
      const double expected = model.parameters[channel * model.stride() + i];
      difference += std::pow(trained[channel * model.count() + i] - expected, 2);
      norm += expected * expected;
    }
  }
  EXPECT_LT(std::sqrt(difference / norm), 1e-3);
}

TEST_F(CudaTest, ViewsMayMoveDifferentObjects) {
  const Case c{"", {Appearance::Radiance, 0}, 500, 48, 48, true, true, -2.0F};
  GaussiansBuffer model = random_model(c, 31);
  for (std::size_t i = 0; i < model.count(); ++i) model.object_id[i] = static_cast<std::uint32_t>(i % 4);
  const Camera camera = look_at({0.5F, 1.5F, 5.0F}, {0, 0, 0}, c.width, c.height, 1.0F);
  const Rigid left{glm::quat(1, 0, 0, 0), {-0.5F, 0, 0}}, right{glm::quat(1, 0, 0, 0), {0.5F, 0.2F, 0}};
  std::vector<SceneState> scenes(3, random_scene(false));
  scenes[0].objects[3] = left;
  scenes[1].objects[1] = right;
  scenes[1].objects[2] = left;
  scenes[1].objects[3] = right;

  cuda::DeviceModel device;
  device.upload(model.view(), nullptr);
  cuda::TrainStep trainer({});
  trainer.set_model(device.view());
  const std::size_t pixels = std::size_t{c.width} * c.height;
  const device::Buffer<std::uint8_t> picture(4 * pixels);
  cudaDeviceSynchronize();
  const auto cpu = make_cpu_rasterizer(1);
  for (const std::size_t k : {1U, 0U, 2U, 1U}) {
    const cuda::TrainView view{{camera, &scenes[k]}, picture.data(), nullptr};
    trainer.forward({&view, 1});
    cudaStreamSynchronize(trainer.stream());
    Image actual(c.width, c.height, 3);
    cudaMemcpy(actual.data.data(), trainer.workspace().color, 3 * pixels * sizeof(float), cudaMemcpyDeviceToHost);
    Render expected;
    cpu->render(model.view(), camera, scenes[k], {}, expected);
    EXPECT_LT(largest_difference(actual, expected.color), 1e-3) << "scene " << k;
  }
}

TEST_F(CudaTest, ViewsMayHaveDifferentSources) {
  const Case c{"", {Appearance::Transfer, 0}, 500, 48, 48, true, true, -2.0F};
  const GaussiansBuffer model = random_model(c, 33);
  const Camera camera = look_at({0.5F, 1.5F, 5.0F}, {0, 0, 0}, c.width, c.height, 1.0F);
  std::vector<SceneState> scenes(3, random_scene(true));  // without sources, with four, with one
  add_sources(scenes[1].light);
  scenes[2].light.sources = {scenes[1].light.sources[1]};
  const std::vector<std::uint8_t> host_rows = random_bytes(4 * model.count(), 7);
  device::Buffer<std::uint8_t> rows, picture;
  rows.upload(host_rows.data(), host_rows.size(), nullptr);
  const std::vector<std::uint8_t> target(std::size_t{4} * c.width * c.height, 90);
  picture.upload(target.data(), target.size(), nullptr);

  std::vector<cuda::TrainView> views;
  std::vector<float> expected;
  for (const SceneState& scene : scenes) {
    cuda::SceneView seen{camera, &scene};
    GaussiansView gaussians = model.view();
    if (&scene == &scenes[1]) {
      seen.visibility = rows.data();
      gaussians.visibility_u8 = host_rows.data();
      seen.visibility_stride = gaussians.visibility_stride = model.count();
      seen.visibility_rows = gaussians.visibility_rows = 4;
    }
    views.push_back({seen, picture.data(), nullptr});
    Render out;
    RenderGradient gradient;
    make_cpu_rasterizer(1)->render(gaussians, camera, scene, {}, out);
    expected.push_back(image_loss(out.color, target.data(), {}, gradient.color));
  }
  EXPECT_GT(std::abs(expected[1] - expected[0]), 0.01F);
  EXPECT_GT(std::abs(expected[2] - expected[0]), 0.01F);

  cuda::DeviceModel device;
  device.upload(model.view(), nullptr);
  cuda::TrainStep trainer({});
  trainer.set_model(device.view());
  trainer.set_learning_rates(std::vector<float>(41, 0.0F));
  cudaDeviceSynchronize();
  for (const std::size_t k : {0U, 1U, 1U, 2U, 0U, 1U, 0U}) {
    trainer.step({&views[k], 1});
    EXPECT_NEAR(trainer.losses()[0], expected[k], 2e-4F) << "scene " << k;
  }
  // Kernels that know no sources come back.
  for (int k = 0; k < 100; ++k) trainer.step({views.data(), 1});
  EXPECT_NEAR(trainer.losses()[0], expected[0], 2e-4F);
  EXPECT_EQ(trainer.workspace().source_room, 0);
  trainer.step(views);
  const std::vector<float> together = trainer.losses();
  for (std::size_t k = 0; k < 3; ++k) EXPECT_NEAR(together[k] * 3, expected[k], 2e-4F) << "in one step, scene " << k;
}

TEST_F(CudaTest, HiddenGaussiansRest) {
  constexpr std::size_t kWalls = 3, kCount = 5;  // walls, one behind them, one beside the picture
  GaussiansBuffer model({Appearance::Radiance, 0}, kCount);
  const auto at = [&](std::size_t channel, std::size_t i) -> float& {
    return model.parameters[channel * model.stride() + i];
  };
  for (std::size_t i = 0; i < kCount; ++i) {
    const bool wall = i < kWalls;
    at(2, i) = wall ? 1.0F - 0.1F * static_cast<float>(i) : -1.0F;
    for (std::size_t k = 3; k < 6; ++k) at(k, i) = wall ? 1.5F : -2.0F;
    at(6, i) = 1.0F;
    at(10, i) = 10.0F;
    for (std::size_t k = 11; k < 14; ++k) at(k, i) = 0.3F;
  }
  at(0, 4) = 50.0F;
  const Camera camera = look_at({0, 0, 5}, {0, 0, 0}, 24, 24, 0.3F);
  const SceneState scene;
  const std::vector<std::uint8_t> target(std::size_t{4} * 24 * 24, 17);
  cuda::DeviceModel device;
  device.upload(model.view(), nullptr);
  cuda::TrainStep trainer({});
  trainer.set_model(device.view());
  trainer.set_learning_rates(std::vector<float>(14, 1e-2F));
  device::Buffer<std::uint8_t> picture;
  picture.upload(target.data(), target.size(), nullptr);
  cudaDeviceSynchronize();
  const cuda::TrainView view{{camera, &scene}, picture.data(), nullptr};
  for (int k = 0; k < 5; ++k) trainer.step({&view, 1});
  std::vector<float> trained(14 * kCount);
  device.download_parameters(trained.data(), trainer.stream());
  cudaStreamSynchronize(trainer.stream());
  for (std::size_t channel = 0; channel < 14; ++channel) {
    for (std::size_t i = kWalls; i < kCount; ++i) EXPECT_EQ(trained[channel * kCount + i], at(channel, i)) << channel;
  }
  EXPECT_NE(trained[11 * kCount], at(11, 0));
  EXPECT_NE(trained[11 * kCount + 1], at(11, 1));
}

}  // namespace
}  // namespace splatbus::raster::testing
