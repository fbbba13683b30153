#include <torch/optim/adam.h>

#include <random>

#include "raster/torch/image_loss.h"
#include "raster/torch/sparse_adam.h"
#include "tensor_scene.h"

namespace splatbus::raster {
namespace {

using testing::OnDevice;
using testing::relative_error;
using testing::TensorScene;
using torch::Tensor;

class Operations : public OnDevice {};

Tensor random_targets(std::int64_t pictures, std::int64_t height, std::int64_t width) {
  torch::manual_seed(3);
  return torch::randint(0, 256, {pictures, height, width, 4}, torch::kUInt8);
}

/// [pictures, 3, height, width] float64 in [0, 1].
Tensor as_reference(const Tensor& targets) {
  return targets.to(torch::kCPU).slice(3, 0, 3).permute({0, 3, 1, 2}).to(torch::kFloat64) / 255.0;
}

Tensor reference_losses(const Tensor& rendered, const Tensor& targets, const LossOptions& options) {
  const Tensor expected = as_reference(targets);
  std::vector<Tensor> losses;
  for (std::int64_t k = 0; k < rendered.size(0); ++k) {
    losses.push_back(reference_loss(rendered[k], expected[k], options.ssim_weight, options.encode_srgb));
  }
  return torch::stack(losses);
}

TEST_P(Operations, LossAndGradientMatchTheReference) {
  for (const LossOptions& options :
       {LossOptions{}, LossOptions{.ssim_weight = 0.5F, .encode_srgb = false}, LossOptions{.ssim_weight = 0}}) {
    SCOPED_TRACE(options.ssim_weight);
    const Tensor targets = random_targets(3, 37, 50);
    torch::manual_seed(4);
    const Tensor truth = (0.0001 + 0.99 * torch::rand({3, 3, 37, 50}, torch::kFloat64).pow(3)).requires_grad_(true);
    const Tensor rendered = truth.detach().to(device(), torch::kFloat32).requires_grad_(true);
    const Tensor ours = image_loss(rendered, targets.to(device()), options);
    const Tensor expected = reference_losses(truth, targets, options);
    EXPECT_LT(testing::largest_difference(ours, expected), 1e-5);
    const Tensor weights = torch::tensor({0.3, -1.0, 2.0}, torch::kFloat64);
    (ours * weights.to(device(), torch::kFloat32)).sum().backward();
    (expected * weights).sum().backward();
    EXPECT_LT(relative_error(rendered.grad(), truth.grad()), 1e-3);

    const at::NoGradGuard no_gradient;
    EXPECT_LT(testing::largest_difference(image_loss(rendered, targets.to(device()), options), expected), 1e-5);
  }
}

TEST_P(Operations, GradientsGoThroughPicturesAndLoss) {
  const TensorScene model(testing::random_scene(testing::transfer_layout(), 100, {}, 5), device());
  const std::vector<Camera> cameras = testing::test_cameras(3, 48, 40);
  const Tensor targets = random_targets(3, 40, 48);
  const Tensor color = rasterize(model.parameters, model.planes, cameras, {model.scene.state}).color;
  image_loss(color, targets.to(device())).mean().backward();
  const Tensor parameters = model.truth();
  const Tensor expected = testing::reference_views(parameters, model.scene, cameras, {model.scene.state}, {}).color;
  reference_losses(expected, targets, {}).mean().backward();
  EXPECT_LT(relative_error(model.parameters.grad(), parameters.grad()), 2e-3);
}

/// u8 RGBA in display space.
Tensor pictures_of(const Tensor& color) {
  const Tensor rgb = color.detach().clamp(0, 1).permute({0, 2, 3, 1});
  return torch::cat({rgb, torch::ones_like(rgb.slice(3, 0, 1))}, 3).mul(255).round().to(torch::kUInt8).contiguous();
}

struct Lesson {
  Tensor targets, parameters;  // the pictures, and where to begin
  TensorScene model;
  std::vector<Camera> cameras = testing::test_cameras(3, 48, 40);

  explicit Lesson(const at::Device& device)
      : model(testing::random_scene(testing::radiance_layout(0), 40, {.spread = 0.8F, .scale_low = 0.1F}, 6), device) {
    const at::NoGradGuard no_gradient;
    targets = pictures_of(draw(model.parameters));
    torch::manual_seed(7);
    const Tensor noise = torch::randn(model.parameters.sizes(), torch::kFloat32).to(device);
    parameters = model.parameters.clone().add_(noise, 0.3).requires_grad_(true);
  }
  [[nodiscard]] Tensor draw(const Tensor& of) const {
    return rasterize(of, model.planes, cameras, {model.scene.state}).color;
  }
  [[nodiscard]] Tensor loss() const { return image_loss(draw(parameters), targets, {.encode_srgb = false}).mean(); }
  /// Trains with any optimiser; the loss before and after.
  template <class Optimizer>
  std::pair<double, double> train(Optimizer& optimizer, int steps) const {
    const double before = loss().template item<double>();
    for (int step = 0; step < steps; ++step) {
      optimizer.zero_grad();
      loss().backward();
      optimizer.step();
    }
    return {before, loss().template item<double>()};
  }
};

TEST_P(Operations, AnOptimizerOfLibTorchRecoversAScene) {
  const Lesson lesson(device());
  torch::optim::Adam optimizer({lesson.parameters}, torch::optim::AdamOptions(0.01));
  const auto [before, after] = lesson.train(optimizer, 150);
  EXPECT_GT(before, 0.02) << "the test shows nothing";
  EXPECT_LT(after, 0.15 * before);
}

TEST_P(Operations, SparseAdamRecoversAScene) {
  const Lesson lesson(device());
  SparseAdam optimizer(lesson.parameters, std::vector<double>(14, 0.01));
  const auto [before, after] = lesson.train(optimizer, 150);
  EXPECT_LT(after, 0.15 * before);
}

TEST_P(Operations, SparseAdamStepsLikeAdamWhereThereIsAGradient) {
  torch::manual_seed(8);
  const Tensor start = torch::randn({14, 1000});
  const Tensor ours = start.to(device()).clone().requires_grad_(true);
  const Tensor theirs = start.clone().requires_grad_(true);
  SparseAdam sparse(ours, std::vector<double>(14, 0.02));
  torch::optim::Adam dense({theirs}, torch::optim::AdamOptions(0.02).eps(1e-15));
  sparse.step();
  EXPECT_TRUE(ours.detach().equal(start.to(device()))) << "no gradient yet";
  for (int step = 0; step < 10; ++step) {
    Tensor gradient = torch::randn({14, 1000});
    gradient.slice(1, 0, 100).zero_();
    ours.mutable_grad() = gradient.to(device());
    theirs.mutable_grad() = gradient;
    sparse.step();
    dense.step();
  }
  EXPECT_LT(testing::largest_difference(ours, theirs), 2e-4);
  EXPECT_TRUE(ours.detach().slice(1, 0, 100).equal(start.slice(1, 0, 100).to(device())));

  // A Gaussian that was not seen begins its own count of steps: the first one is as long as the rate.
  Tensor gradient = torch::zeros({14, 1000});
  gradient.slice(1, 0, 100).fill_(0.5);
  ours.mutable_grad() = gradient.to(device());
  sparse.step();
  const Tensor moved = (ours.detach().to(torch::kCPU) - start).slice(1, 0, 100);
  EXPECT_LT(testing::largest_difference(moved, torch::full({14, 100}, -0.02)), 1e-5);
  sparse.zero_grad();
  EXPECT_FALSE(ours.grad().defined());
}

TEST_P(Operations, SparseAdamTellsGraphsThatItChangedTheParameters) {
  const Lesson lesson(device());
  SparseAdam optimizer(lesson.parameters, std::vector<double>(14, 0.01));
  lesson.loss().backward();
  const Tensor stale = lesson.loss();
  optimizer.step();
  EXPECT_THROW(stale.backward(), c10::Error);
}

INSTANTIATE_TEST_SUITE_P(Devices, Operations, ::testing::Values("cpu", "cuda"), testing::device_name);

}  // namespace
}  // namespace splatbus::raster
