// The CUDA backend against the CPU one, whose gradients are checked against autograd: same pictures, same gradients.
#include <cuda_runtime.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "raster/adam.h"
#include "raster/cuda/cuda_rasterizer.h"
#include "raster/cuda/device_model.h"
#include "raster/cuda/train_step.h"
#include "raster/loss.h"
#include "raster/rasterizer.h"

namespace splatbus::raster {
namespace {

struct Case {
  const char* name;
  ParameterLayout layout;
  int count;
  std::uint32_t width, height;
  bool antialias;
  bool objects;
  float log_scale;
};

std::string case_name(const testing::TestParamInfo<Case>& info) {
  return info.param.name;
}

GaussiansBuffer random_model(const Case& c, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> normal;
  std::uniform_real_distribution<float> uniform;
  GaussiansBuffer model(c.layout, static_cast<std::size_t>(c.count));
  const std::size_t stride = model.stride();
  for (std::size_t i = 0; i < model.count(); ++i) {
    const auto put = [&](int channel, float value) {
      model.parameters[static_cast<std::size_t>(channel) * stride + i] = value;
    };
    for (int k = 0; k < 3; ++k) {
      put(k, 1.2F * normal(random));
      put(3 + k, c.log_scale + 0.7F * normal(random));
      model.normal[static_cast<std::size_t>(k) * stride + i] = normal(random);
    }
    for (int k = 0; k < 4; ++k) put(6 + k, normal(random));
    put(10, 2.0F * normal(random));
    for (int k = 11; k < c.layout.channels(); ++k)
      put(k, (k < 14 ? 0.5F : 0.1F) * normal(random) + (k < 14 ? 0.4F : 0.0F));
    const float n = std::hypot(model.normal[i], model.normal[stride + i], model.normal[2 * stride + i]);
    for (std::size_t k = 0; k < 3; ++k) model.normal[k * stride + i] /= n;
    model.visibility[i] = uniform(random);
    model.object_id[i] = i % 3 == 0 ? 7U : 0U;
    model.flags[i] = i % 11 == 0 ? kFrozen : 0U;
  }
  return model;
}

SceneState random_scene(bool objects) {
  SceneState scene;
  for (std::size_t k = 0; k < 9; ++k)
    scene.light.ambient_sh[k] = glm::vec3(0.8F, 0.7F, 0.9F) / (1.0F + static_cast<float>(k));
  scene.light.sun_direction = glm::normalize(glm::vec3(0.4F, 0.8F, 0.3F));
  scene.light.sun_irradiance = {2.0F, 1.8F, 1.5F};
  scene.light.background = {0.2F, 0.3F, 0.5F};
  if (objects) {
    scene.objects[7] = {glm::angleAxis(0.7F, glm::normalize(glm::vec3(1, 2, 3))), {0.3F, -0.2F, 0.4F}};
  }
  return scene;
}

/// ||a - b|| / ||b|| over channels [first, last) of Gaussians' gradients.
double relative_error(const ParameterGradient& a, const ParameterGradient& b, int first, int last) {
  double difference = 0, norm = 0;
  for (int c = first; c < last; ++c) {
    for (std::size_t i = 0; i < a.count; ++i) {
      const std::size_t at = static_cast<std::size_t>(c) * a.stride + i;
      difference += std::pow(a.values[at] - b.values[at], 2);
      norm += std::pow(b.values[at], 2);
    }
  }
  return std::sqrt(difference / std::max(norm, 1e-30));
}

double largest_difference(const Image& a, const Image& b) {
  double largest = 0;
  for (std::size_t k = 0; k < a.data.size(); ++k) largest = std::max(largest, std::abs(double{a.data[k]} - b.data[k]));
  return largest;
}

class CudaParity : public testing::TestWithParam<Case> {
 protected:
  void SetUp() override {
    int devices = 0;
    if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) GTEST_SKIP() << "no CUDA device";
  }
};

TEST_P(CudaParity, PicturesAndGradientsMatchTheCpuBackend) {
  const Case& c = GetParam();
  const GaussiansBuffer model = random_model(c, 11);
  const SceneState scene = random_scene(c.objects);
  const Camera camera = look_at({0.5F, 1.5F, 5.0F}, {0, 0, 0}, c.width, c.height, 1.0F);
  const bool transfer = c.layout.appearance == Appearance::Transfer;
  const RenderOptions options{.antialias = c.antialias, .albedo = transfer};
  const auto cpu = make_cpu_rasterizer(2);
  const auto gpu = make_cuda_rasterizer();
  Render expected, actual;
  cpu->forward(model.view(), camera, scene, options, expected);
  gpu->forward(model.view(), camera, scene, options, actual);
  EXPECT_LT(largest_difference(actual.color, expected.color), 1e-3);
  EXPECT_LT(largest_difference(actual.alpha, expected.alpha), 1e-3);
  if (transfer) EXPECT_LT(largest_difference(actual.albedo, expected.albedo), 1e-3);

  std::mt19937 random(5);
  std::normal_distribution<float> normal;
  RenderGradient gradient;
  gradient.color = Image(c.width, c.height, 3);
  for (float& value : gradient.color.data) value = normal(random);
  if (transfer) {
    gradient.albedo = Image(c.width, c.height, 3);
    for (float& value : gradient.albedo.data) value = normal(random);
  }
  ParameterGradient expected_gradient, actual_gradient;
  expected_gradient.clear(model.view());
  actual_gradient.clear(model.view());
  cpu->backward(gradient, expected_gradient);
  gpu->backward(gradient, actual_gradient);
  const int appearance_end = c.layout.channels();
  EXPECT_LT(relative_error(actual_gradient, expected_gradient, 0, 3), 1e-3) << "mean";
  EXPECT_LT(relative_error(actual_gradient, expected_gradient, 3, 6), 1e-3) << "log scale";
  EXPECT_LT(relative_error(actual_gradient, expected_gradient, 6, 10), 1e-3) << "rotation";
  EXPECT_LT(relative_error(actual_gradient, expected_gradient, 10, 11), 1e-3) << "opacity";
  EXPECT_LT(relative_error(actual_gradient, expected_gradient, 11, 14), 1e-3) << "albedo or DC";
  if (appearance_end > 14)
    EXPECT_LT(relative_error(actual_gradient, expected_gradient, 14, appearance_end), 1e-3) << "rest";
}

INSTANTIATE_TEST_SUITE_P(
    Cases, CudaParity,
    testing::Values(Case{"Transfer", {Appearance::Transfer, 0}, 400, 96, 64, true, true, -2.0F},
                    Case{"TransferClassic", {Appearance::Transfer, 0}, 400, 70, 50, false, false, -2.0F},
                    Case{"TransferSmall", {Appearance::Transfer, 0}, 3000, 128, 128, true, true, -4.0F},
                    Case{"Radiance0", {Appearance::Radiance, 0}, 500, 64, 64, true, false, -2.0F},
                    Case{"Radiance3", {Appearance::Radiance, 3}, 500, 100, 80, true, true, -2.5F},
                    Case{"Huge", {Appearance::Radiance, 1}, 60, 64, 64, true, false, 0.5F}),
    case_name);

TEST_F(CudaParity, TrainStepFollowsTheCpuOptimizer) {
  const Case c{"", {Appearance::Transfer, 0}, 2000, 96, 80, true, true, -3.0F};
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
  const std::vector<float> rates(41, 1e-3F);
  constexpr int kSteps = 6;

  cuda::DeviceModel device;
  device.upload(model.view(), nullptr);
  cuda::TrainStep trainer({.albedo_weight = 0.5F});
  trainer.set_model(device.view(), model.object_id.data());
  trainer.set_learning_rates(rates);
  std::vector<cuda::DeviceBuffer<std::uint8_t>> pictures(3);
  std::vector<cuda::TrainView> views;
  for (std::size_t k = 0; k < 3; ++k) {
    pictures[k].upload(targets[k].data(), targets[k].size(), nullptr);
    views.push_back({{cameras[k], &scene}, pictures[k].data(), pictures[k].data()});
  }
  cudaDeviceSynchronize();
  const std::size_t group = trainer.add_group(views);
  for (int k = 0; k < kSteps; ++k) trainer.step(group);
  const std::vector<float> gpu_losses = trainer.losses();
  std::vector<float> trained(41 * model.count());
  device.download_parameters(trained.data(), trainer.stream());
  cudaStreamSynchronize(trainer.stream());

  const auto cpu = make_cpu_rasterizer(2);
  Adam adam;
  adam.resize(c.layout, model.count(), model.stride());
  float loss = 0;
  for (int step = 0; step < kSteps; ++step) {
    ParameterGradient gradient;
    gradient.clear(model.view());
    loss = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      Render out;
      cpu->forward(model.view(), cameras[k], scene, {.albedo = true}, out);
      RenderGradient g;
      loss += image_loss(out.color, targets[k].data(), {}, g.color) / 3;
      loss += 0.5F * image_loss(out.albedo, targets[k].data(), {}, g.albedo) / 3;
      for (float& value : g.color.data) value /= 3;
      for (float& value : g.albedo.data) value *= 0.5F / 3;
      cpu->backward(g, gradient);
    }
    adam.step(model.parameters.data(), model.flags.data(), gradient, rates, 2);
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

}  // namespace
}  // namespace splatbus::raster
