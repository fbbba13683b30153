#include <gtest/gtest.h>
#include <torch/torch.h>

#include <random>

#include "raster/adam.h"
#include "raster/loss.h"
#include "raster/torch/reference_renderer.h"
#include "scenes.h"

namespace splatbus::raster {
namespace {

void expect_loss_like_autograd(std::uint32_t width, std::uint32_t height, bool encode_srgb, float ssim_weight) {
  std::mt19937 generator(11);
  Image rendered(width, height, 3);
  std::vector<std::uint8_t> target(std::size_t{width} * height * 4);
  for (std::uint8_t& value : target) value = static_cast<std::uint8_t>(generator() >> 24U);
  // Near the target's smooth part, with some values at the curve's linear end; inside (0, 1), where clamping is silent.
  for (float& value : rendered.data) {
    value = 0.0001F + 0.99F * std::pow(static_cast<float>(generator() >> 8U) / 16777216.0F, 3.0F);
  }
  Image gradient;
  const float loss = image_loss(rendered, target.data(), {ssim_weight, encode_srgb}, gradient);

  const auto w = static_cast<std::int64_t>(width), h = static_cast<std::int64_t>(height);
  torch::Tensor x = torch::from_blob(rendered.data.data(), {3, h, w}, torch::kFloat32).to(torch::kFloat64).clone();
  x.requires_grad_(true);
  const torch::Tensor y =
      torch::from_blob(target.data(), {h, w, 4}, torch::kUInt8).slice(2, 0, 3).permute({2, 0, 1}).to(torch::kFloat64) /
      255.0;
  const torch::Tensor reference = reference_loss(x, y, ssim_weight, encode_srgb);
  reference.backward();
  EXPECT_NEAR(loss, reference.item<double>(), 1e-5);
  const torch::Tensor ours = torch::from_blob(gradient.data.data(), {3, h, w}, torch::kFloat32).to(torch::kFloat64);
  EXPECT_LT(((ours - x.grad()).norm() / x.grad().norm()).item<double>(), 1e-3);
}

TEST(OracleLoss, GradientMatchesAutograd) {
  expect_loss_like_autograd(50, 37, true, 0.2F);
  expect_loss_like_autograd(64, 48, false, 0.2F);
  expect_loss_like_autograd(17, 5, true, 1.0F);
  expect_loss_like_autograd(3, 40, true, 0.0F);
}

TEST(OracleAdam, StepsMatchTorch) {
  const testing::TestScene scene = testing::random_scene(testing::transfer_layout(), 37, {}, 3);
  std::vector<float> ours = scene.parameters;
  const auto channels = static_cast<std::size_t>(scene.layout.channels());
  ParameterGradient gradient;
  gradient.clear(scene.view());
  std::fill(gradient.touched.begin(), gradient.touched.end(), std::uint8_t{1});
  std::vector<float> rates(channels, 0.01F);
  for (std::size_t c = 0; c < channels; ++c) rates[c] *= 1 + static_cast<float>(c);

  std::vector<torch::Tensor> tensors;
  std::vector<torch::optim::OptimizerParamGroup> groups;
  for (std::size_t c = 0; c < channels; ++c) {
    torch::Tensor row = torch::from_blob(ours.data() + c * scene.stride, {37}, torch::kFloat32).clone();
    row.requires_grad_(true);
    tensors.push_back(row);
    groups.emplace_back(std::vector<torch::Tensor>{row},
                        std::make_unique<torch::optim::AdamOptions>(torch::optim::AdamOptions(rates[c]).eps(1e-15)));
  }
  torch::optim::Adam torch_adam(groups, torch::optim::AdamOptions(0.01).eps(1e-15));
  Adam adam;
  adam.resize(scene.layout, scene.count);
  std::mt19937 generator(5);
  for (int step = 0; step < 12; ++step) {
    for (std::size_t c = 0; c < channels; ++c) {
      float* row = gradient.values.data() + c * scene.stride;
      for (std::size_t i = 0; i < 37; ++i) row[i] = static_cast<float>(generator() >> 8U) / 16777216.0F - 0.3F;
      tensors[c].mutable_grad() = torch::from_blob(row, {37}, torch::kFloat32).clone();
    }
    torch_adam.step();
    adam.step(scene.view(), ours.data(), gradient, rates, 2);
  }
  for (std::size_t c = 0; c < channels; ++c) {
    const torch::Tensor row = torch::from_blob(ours.data() + c * scene.stride, {37}, torch::kFloat32);
    EXPECT_LT((row - tensors[c]).abs().max().item<float>(), 2e-4F * rates[c] / 0.01F) << c;
  }
}

}  // namespace
}  // namespace splatbus::raster
