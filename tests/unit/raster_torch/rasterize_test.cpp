#include "raster/torch/rasterize.h"

#include <array>
#include <thread>

#include "tensor_scene.h"

namespace splatbus::raster {
namespace {

using testing::as_truth;
using testing::OnDevice;
using testing::relative_error;
using testing::TensorScene;
using torch::Tensor;

struct Group {
  const char* name;
  int begin, end;
};

std::vector<Group> groups_of(const ParameterLayout& layout) {
  std::vector<Group> groups{{"mean", 0, 3}, {"log_scale", 3, 6}, {"rotation", 6, 10}, {"opacity_logit", 10, 11}};
  if (layout.appearance == Appearance::Transfer) {
    groups.push_back({"albedo", 11, 14});
    groups.push_back({"residual", 14, 41});
  } else {
    groups.push_back({"sh", 11, layout.channels()});
  }
  return groups;
}

/// Columns of frozen Gaussians are zero in ours, and made so in the truth.
void expect_gradients_near(const Tensor& ours, const Tensor& truth, const TensorScene& model) {
  ASSERT_TRUE(ours.defined());
  Tensor expected = as_truth(truth).clone();
  for (std::size_t i = 0; i < model.scene.count; ++i) {
    if ((model.scene.flags[i] & kFrozen) == 0) continue;
    const auto column = static_cast<std::int64_t>(i);
    expected.select(1, column).zero_();
    EXPECT_EQ(as_truth(ours).select(1, column).abs().sum().item<double>(), 0) << "frozen Gaussian " << i;
  }
  for (const Group& group : groups_of(model.scene.layout)) {
    const Tensor a = ours.slice(0, group.begin, group.end), b = expected.slice(0, group.begin, group.end);
    EXPECT_GT(b.norm().item<double>(), 0) << group.name << ": the test shows nothing";
    EXPECT_LT(relative_error(a, b), 1e-3) << group.name;
  }
}

/// A weighted sum of all planes; the same weights for the same seed.
Tensor objective(const RasterizedViews& views, std::uint64_t seed) {
  torch::manual_seed(seed);
  Tensor sum = torch::zeros({}, views.color.options().requires_grad(false));
  for (const Tensor& plane : {views.color, views.alpha, views.albedo, views.depth}) {
    if (!plane.defined()) continue;
    const Tensor weights = 2 * torch::rand(plane.sizes(), torch::kFloat64) - 1;
    sum = sum + (plane * weights.to(plane.options().requires_grad(false))).sum();
  }
  return sum;
}

void expect_like_reference(const TensorScene& model, const std::vector<Camera>& cameras,
                           const std::vector<SceneState>& scenes, const RenderOptions& options) {
  const RasterizedViews ours = rasterize(model.parameters, model.planes, cameras, scenes, options);
  const Tensor parameters = model.truth();
  const RasterizedViews truth = testing::reference_views(parameters, model.scene, cameras, scenes, options);
  const auto expect_near = [](const Tensor& a, const Tensor& b, const char* name) {
    ASSERT_EQ(a.defined(), b.defined()) << name;
    if (!a.defined()) return;
    EXPECT_EQ(a.sizes(), b.sizes()) << name;
    EXPECT_LT(testing::largest_difference(a, b), 1e-3 * std::max(1.0, as_truth(b).abs().max().item<double>())) << name;
  };
  expect_near(ours.color, truth.color, "color");
  expect_near(ours.alpha, truth.alpha, "alpha");
  expect_near(ours.albedo, truth.albedo, "albedo");
  expect_near(ours.depth, truth.depth, "depth");

  objective(ours, 5).backward();
  objective(truth, 5).backward();
  expect_gradients_near(model.parameters.grad(), parameters.grad(), model);
}

RenderOptions every_plane() {
  RenderOptions options;
  options.albedo = options.depth = true;
  return options;
}

class Rasterize : public OnDevice {};

TEST_P(Rasterize, ThreeTransferCamerasMatchTheReference) {
  const TensorScene model(testing::random_scene(testing::transfer_layout(), 120, {}, 1), device());
  expect_like_reference(model, testing::test_cameras(3, 43, 37), {model.scene.state}, every_plane());
}

TEST_P(Rasterize, ThreeRadianceCamerasMatchTheReference) {
  for (int degree = 0; degree <= 3; ++degree) {
    SCOPED_TRACE(degree);
    const TensorScene model(testing::random_scene(testing::radiance_layout(degree), 80, {}, 2), device());
    expect_like_reference(model, testing::test_cameras(3, 43, 37), {model.scene.state}, every_plane());
  }
}

TEST_P(Rasterize, EachCameraHasItsOwnScene) {
  const TensorScene model(testing::random_scene(testing::transfer_layout(), 90, {}, 3), device());
  std::vector<SceneState> scenes(2, model.scene.state);
  scenes[1].light.sun_direction = glm::normalize(glm::vec3(-0.5F, 0.4F, 0.6F));
  testing::add_sources(scenes[1].light);
  scenes[1].objects[7].rigid.translation += glm::vec3(0.2F, 0.1F, -0.1F);
  scenes[1].objects[7].scale = 1.5F;
  scenes[1].objects.erase(14);
  expect_like_reference(model, testing::test_cameras(2, 40, 30), scenes, {});
}

TEST_P(Rasterize, FrozenGaussiansShowButGetNoGradient) {
  testing::TestScene scene = testing::random_scene(testing::transfer_layout(), 100, {}, 4);
  for (std::size_t i = 0; i < scene.count; i += 3) scene.flags[i] = kFrozen;
  const TensorScene model(std::move(scene), device());
  expect_like_reference(model, testing::test_cameras(2, 40, 30), {model.scene.state}, {});
}

TEST_P(Rasterize, WithoutAntialiasing) {
  RenderOptions options;
  options.antialias = false;
  const TensorScene model(testing::random_scene(testing::radiance_layout(1), 100, {}, 6), device());
  expect_like_reference(model, testing::test_cameras(1, 40, 30), {model.scene.state}, options);
}

TEST_P(Rasterize, GradientsOfEachPlaneAlone) {
  const TensorScene model(testing::random_scene(testing::transfer_layout(), 80, {}, 7), device());
  const std::vector<Camera> cameras = testing::test_cameras(2, 33, 29);
  const auto of_plane = [](const RasterizedViews& views, int plane) {
    return std::array{views.color, views.alpha, views.albedo, views.depth}[static_cast<std::size_t>(plane)]
        .square()
        .sum();
  };
  for (int plane = 0; plane < 4; ++plane) {
    SCOPED_TRACE(plane);
    model.parameters.mutable_grad() = Tensor();
    of_plane(rasterize(model.parameters, model.planes, cameras, {model.scene.state}, every_plane()), plane).backward();
    const Tensor parameters = model.truth();
    of_plane(testing::reference_views(parameters, model.scene, cameras, {model.scene.state}, every_plane()), plane)
        .backward();
    EXPECT_LT(relative_error(model.parameters.grad(), parameters.grad()), 1e-3);
  }
}

TEST_P(Rasterize, PlanesMayBeMissing) {
  testing::SceneRecipe still;
  still.objects = false;
  TensorScene model(testing::random_scene(testing::radiance_layout(1), 60, still, 8), device());
  model.planes = {};
  expect_like_reference(model, testing::test_cameras(1, 40, 30), {model.scene.state}, {});
}

TEST_P(Rasterize, PassesMayInterleaveAndRepeat) {
  const TensorScene first(testing::random_scene(testing::transfer_layout(), 70, {}, 9), device());
  const TensorScene second(testing::random_scene(testing::radiance_layout(2), 90, {}, 10), device());
  const std::vector<Camera> cameras = testing::test_cameras(2, 40, 30);
  const auto draw = [&](const TensorScene& model) {
    return objective(rasterize(model.parameters, model.planes, cameras, {model.scene.state}, {}), 11);
  };
  draw(first).backward();
  draw(second).backward();
  const Tensor first_alone = first.parameters.grad().clone(), second_alone = second.parameters.grad().clone();
  const Tensor of_first = draw(first), of_second = draw(second);
  of_first.backward({}, /*retain_graph=*/true);
  of_second.backward();
  of_first.backward();
  EXPECT_LT(relative_error(first.parameters.grad(), 3 * first_alone), 1e-5);
  EXPECT_LT(relative_error(second.parameters.grad(), 2 * second_alone), 1e-5);
  EXPECT_THROW(of_second.backward(), c10::Error) << "what the backward pass reads is gone";
}

TEST_P(Rasterize, ThreadsMayCallAtOnce) {
  const std::vector<Camera> cameras = testing::test_cameras(2, 60, 50);
  std::vector<TensorScene> models;
  std::vector<Tensor> alone;
  const auto gradient_of = [&](const TensorScene& model) {
    model.parameters.mutable_grad() = Tensor();
    rasterize(model.parameters, model.planes, cameras, {model.scene.state}).color.square().sum().backward();
    return model.parameters.grad();
  };
  for (std::uint32_t k = 0; k < 4; ++k) {
    models.emplace_back(testing::random_scene(testing::transfer_layout(), 100 + 300 * k, {}, 20 + k), device());
    alone.push_back(gradient_of(models.back()).clone());
  }
  std::vector<std::thread> threads;
  for (const TensorScene& model : models) {
    threads.emplace_back([&] {
      for (int k = 0; k < 5; ++k) (void)gradient_of(model);
    });
  }
  for (std::thread& thread : threads) thread.join();
  for (std::size_t k = 0; k < models.size(); ++k) {
    EXPECT_LT(relative_error(models[k].parameters.grad(), alone[k]), 1e-5) << k;
  }
}

TEST_P(Rasterize, PicturesWithoutAGradientAreTheSame) {
  const TensorScene model(testing::random_scene(testing::transfer_layout(), 100, {}, 12), device());
  const std::vector<Camera> cameras = testing::test_cameras(3, 40, 30);
  const RasterizedViews with = rasterize(model.parameters, model.planes, cameras, {model.scene.state}, every_plane());
  const at::NoGradGuard no_gradient;
  const RasterizedViews without =
      rasterize(model.parameters, model.planes, cameras, {model.scene.state}, every_plane());
  EXPECT_TRUE(with.color.requires_grad());
  EXPECT_FALSE(without.color.requires_grad());
  EXPECT_LT(testing::largest_difference(without.color, with.color), 1e-5);
  EXPECT_LT(testing::largest_difference(without.alpha, with.alpha), 1e-5);
  EXPECT_LT(testing::largest_difference(without.albedo, with.albedo), 1e-5);
  EXPECT_LT(testing::largest_difference(without.depth, with.depth), 1e-4);
}

TEST_P(Rasterize, ListsThatDoNotFitAreDrawnAgain) {
  // Few pairs, then many of the same kind of call.
  const std::vector<Camera> cameras = testing::test_cameras(2, 200, 160);
  testing::SceneRecipe tiny{.scale_low = 0.001F, .scale_high = 0.002F};
  testing::SceneRecipe wide{.scale_low = 0.5F, .scale_high = 1, .logit_low = -4, .logit_high = -3};
  const at::NoGradGuard no_gradient;
  for (const bool few : {true, false}) {
    const TensorScene model(testing::random_scene(testing::radiance_layout(0), 2000, few ? tiny : wide, 13), device());
    const RasterizedViews ours = rasterize(model.parameters, model.planes, cameras, {model.scene.state});
    const TensorScene on_cpu(model.scene, at::kCPU);
    const RasterizedViews expected = rasterize(on_cpu.parameters, on_cpu.planes, cameras, {model.scene.state});
    EXPECT_LT(testing::largest_difference(ours.color, expected.color), 1e-3);
  }
}

TEST_P(Rasterize, NoGaussiansShowTheBackground) {
  const TensorScene model(testing::random_scene(testing::radiance_layout(1), 0, {}, 14), device());
  const RasterizedViews views = rasterize(model.parameters, {}, testing::test_cameras(2, 20, 10), {model.scene.state});
  EXPECT_EQ(views.alpha.abs().max().item<float>(), 0);
  EXPECT_NEAR(views.color[1][2].mean().item<float>(), srgb_from_linear(model.scene.state.light.background.z), 1e-5);
  views.color.sum().backward();
  EXPECT_EQ(model.parameters.grad().sizes(), model.parameters.sizes());
}

TEST_P(Rasterize, ValuesThatAreNotFiniteStayWithTheirGaussians) {
  testing::TestScene broken = testing::random_scene(testing::transfer_layout(), 120, {}, 15);
  for (std::size_t i = 0; i < broken.count; i += 2) broken.at(static_cast<int>(i / 2) % 41, i) = std::nanf("");
  const TensorScene model(broken, device());
  const RasterizedViews views =
      rasterize(model.parameters, model.planes, testing::test_cameras(2, 40, 30), {broken.state}, every_plane());
  for (const Tensor& plane : {views.color, views.alpha, views.albedo, views.depth}) {
    EXPECT_TRUE(plane.isfinite().all().item<bool>());
  }
  objective(views, 17).backward();
  const Tensor gradient = model.parameters.grad().to(torch::kCPU);
  for (std::int64_t i = 1; i < gradient.size(1); i += 2) {
    EXPECT_TRUE(gradient.select(1, i).isfinite().all().item<bool>()) << i;
  }
}

TEST_P(Rasterize, StatisticsAreThoseOfTheRasterizer) {
  const TensorScene model(testing::random_scene(testing::transfer_layout(), 150, {}, 16), device());
  const std::vector<Camera> cameras = testing::test_cameras(2, 43, 37);
  const auto values = model.parameters.detach().options();
  const auto count = static_cast<std::int64_t>(model.scene.count);
  const GaussianStatistics statistics{torch::zeros({count}, values), torch::zeros({count}, values),
                                      torch::zeros({count}, values.dtype(torch::kUInt8))};
  rasterize(model.parameters, model.planes, cameras, {model.scene.state}, {}, statistics).color.sum().backward();

  ParameterGradient expected;
  expected.clear(model.scene.view());
  const auto rasterizer = make_cpu_rasterizer(1);
  for (const Camera& camera : cameras) {
    Render render;
    rasterizer->forward(model.scene.view(), camera, model.scene.state, {}, render);
    RenderGradient gradient;
    gradient.color = render.color;
    std::fill(gradient.color.data.begin(), gradient.color.data.end(), 1.0F);
    rasterizer->backward(gradient, expected);
  }
  const auto as_tensor = [](std::vector<float>& from) {
    return torch::from_blob(from.data(), {static_cast<std::int64_t>(from.size())}, torch::kFloat32);
  };
  EXPECT_LT(relative_error(statistics.mean2d_norm, as_tensor(expected.mean2d_norm)), 1e-3);
  EXPECT_LT(relative_error(statistics.contribution, as_tensor(expected.contribution)), 1e-3);
  const Tensor touched = torch::from_blob(expected.touched.data(), {count}, torch::kUInt8).ne(0);
  // A pixel on the edge of 1/255 may fall either way.
  EXPECT_LE(statistics.touched.to(torch::kCPU).ne(0).ne(touched).sum().item<std::int64_t>(), 1);
}

INSTANTIATE_TEST_SUITE_P(Devices, Rasterize, ::testing::Values("cpu", "cuda"), testing::device_name);

}  // namespace
}  // namespace splatbus::raster
