#include <gtest/gtest.h>
#include <hwy/targets.h>
#include <torch/torch.h>

#include "raster/torch/reference_renderer.h"
#include "scenes.h"

namespace splatbus::raster {
namespace {

using testing::SceneRecipe;
using testing::TestScene;

double relative_error(const std::vector<double>& ours, const std::vector<double>& truth) {
  double error = 0, norm = 0;
  for (std::size_t i = 0; i < truth.size(); ++i) {
    error += (ours[i] - truth[i]) * (ours[i] - truth[i]);
    norm += truth[i] * truth[i];
  }
  return std::sqrt(error) / std::max(std::sqrt(norm), 1e-12);
}

std::vector<double> doubles(const torch::Tensor& tensor) {
  const torch::Tensor flat = tensor.detach().to(torch::kFloat64).contiguous().reshape({-1});
  return {flat.data_ptr<double>(), flat.data_ptr<double>() + flat.numel()};
}
std::vector<double> doubles(const std::vector<float>& values) {
  return {values.begin(), values.end()};
}

/// Random gradients of an image, and the same as a tensor.
torch::Tensor random_gradient(Image& image, const Camera& camera, std::uint32_t channels, std::uint32_t seed) {
  image = Image(camera.width, camera.height, channels);
  std::mt19937 generator(seed);
  for (float& value : image.data) value = static_cast<float>(generator() >> 8U) * (2.0F / 16777216.0F) - 1;
  return torch::from_blob(image.data.data(),
                          {static_cast<std::int64_t>(channels), static_cast<std::int64_t>(camera.height),
                           static_cast<std::int64_t>(camera.width)},
                          torch::kFloat32)
      .to(torch::kFloat64);
}

struct ChannelGroup {
  const char* name;
  int begin, end;
};

/// Image and every gradient of the CPU rasteriser against float64 autograd.
void expect_like_oracle(const TestScene& scene, const Camera& camera, const RenderOptions& options,
                        double tolerance = 1e-3) {
  const GaussiansView view = scene.view();
  const auto rasterizer = make_cpu_rasterizer(2);
  Render render;
  rasterizer->forward(view, camera, scene.state, options, render);

  const auto n = static_cast<std::int64_t>(scene.count), channels = std::int64_t{scene.layout.channels()};
  torch::Tensor parameters = torch::from_blob(const_cast<float*>(scene.parameters.data()),
                                              {channels, static_cast<std::int64_t>(scene.stride)}, torch::kFloat32)
                                 .slice(1, 0, n)
                                 .to(torch::kFloat64)
                                 .clone();
  parameters.requires_grad_(true);
  const ReferenceRender reference = reference_render(parameters, view, camera, scene.state, options);
  EXPECT_LT(relative_error(doubles(render.color.data), doubles(reference.color)), 1e-4) << "colour";
  EXPECT_LT(relative_error(doubles(render.alpha.data), doubles(reference.alpha)), 1e-4) << "alpha";

  RenderGradient gradient;
  torch::Tensor objective = (reference.color * random_gradient(gradient.color, camera, 3, 1)).sum();
  objective = objective + (reference.alpha * random_gradient(gradient.alpha, camera, 1, 2)[0]).sum();
  if (options.albedo) {
    EXPECT_LT(relative_error(doubles(render.albedo.data), doubles(reference.albedo)), 1e-4) << "albedo";
    objective = objective + (reference.albedo * random_gradient(gradient.albedo, camera, 3, 3)).sum();
  }
  if (options.depth) {
    EXPECT_LT(relative_error(doubles(render.depth.data), doubles(reference.depth)), 1e-4) << "depth";
    objective = objective + (reference.depth * random_gradient(gradient.depth, camera, 1, 4)[0]).sum();
  }
  objective.backward();
  const torch::Tensor& truth = parameters.grad();

  ParameterGradient ours;
  ours.clear(view);
  rasterizer->backward(gradient, ours);
  std::vector<ChannelGroup> groups{{"mean", 0, 3}, {"log_scale", 3, 6}, {"rotation", 6, 10}, {"opacity_logit", 10, 11}};
  if (scene.layout.appearance == Appearance::Transfer) {
    groups.push_back({"albedo", 11, 14});
    groups.push_back({"residual", 14, 41});
  } else {
    groups.push_back({"sh", 11, scene.layout.channels()});
  }
  for (const ChannelGroup& group : groups) {
    std::vector<double> a, b;
    for (int c = group.begin; c < group.end; ++c) {
      const std::vector<double> row = doubles(truth[c]);
      for (std::size_t i = 0; i < scene.count; ++i) {
        const bool frozen = (scene.flags[i] & kFrozen) != 0;
        a.push_back(ours.values[static_cast<std::size_t>(c) * scene.stride + i]);
        b.push_back(frozen ? 0 : row[i]);
      }
    }
    double norm = 0;
    for (const double value : b) norm += value * value;
    EXPECT_GT(norm, 0) << group.name << ": the test shows nothing";
    EXPECT_LT(relative_error(a, b), tolerance) << group.name;
  }
}

struct Case {
  const char* name;
  SceneRecipe recipe;
  std::size_t count;
};

class OracleTest : public ::testing::TestWithParam<std::tuple<Case, int>> {
 protected:
  /// -1: Transfer, else Radiance of that degree.
  [[nodiscard]] static ParameterLayout layout() {
    const int degree = std::get<1>(GetParam());
    return degree < 0 ? testing::transfer_layout() : testing::radiance_layout(degree);
  }
};

TEST_P(OracleTest, ImageAndGradientsMatchAutograd) {
  const Case& test = std::get<0>(GetParam());
  RenderOptions options;
  options.albedo = layout().appearance == Appearance::Transfer;
  options.depth = true;
  for (std::uint32_t seed = 1; seed <= 2; ++seed) {
    SCOPED_TRACE(seed);
    expect_like_oracle(testing::random_scene(layout(), test.count, test.recipe, seed), testing::test_camera(43, 37),
                       options);
  }
}

INSTANTIATE_TEST_SUITE_P(
    Scenes, OracleTest,
    ::testing::Combine(
        ::testing::Values(
            Case{"overlapping", {.spread = 0.3F, .scale_low = 0.1F, .scale_high = 0.4F, .logit_high = 6}, 120},
            Case{"elongated", {.scale_low = 0.002F, .scale_high = 0.8F}, 80},
            Case{"transparent", {.logit_low = -6, .logit_high = -3}, 150},
            Case{"off_screen", {.spread = 6, .scale_high = 1}, 200},
            Case{"huge", {.spread = 2, .scale_low = 0.5F, .scale_high = 20, .logit_low = -4, .logit_high = -1}, 40},
            Case{"tiny", {.scale_low = 0.0005F, .scale_high = 0.01F}, 300}),
        ::testing::Values(-1, 3)),
    [](const auto& test) {
      return std::string(std::get<0>(test.param).name) + (std::get<1>(test.param) < 0 ? "_transfer" : "_radiance");
    });

TEST(Oracle, EveryRadianceDegree) {
  for (int degree = 0; degree <= 2; ++degree) {
    SCOPED_TRACE(degree);
    expect_like_oracle(testing::random_scene(testing::radiance_layout(degree), 60, {}, 5), testing::test_camera(33, 18),
                       {});
  }
}

TEST(Oracle, WithoutAntialiasingAndPlainPlanes) {
  RenderOptions options;
  options.antialias = false;
  expect_like_oracle(testing::random_scene(testing::transfer_layout(), 100, {}, 6), testing::test_camera(40, 40),
                     options);
}

TEST(Oracle, FrozenGaussiansShowButGetNoGradient) {
  TestScene scene = testing::random_scene(testing::transfer_layout(), 100, {}, 7);
  for (std::size_t i = 0; i < scene.count; i += 3) scene.flags[i] = kFrozen;
  expect_like_oracle(scene, testing::test_camera(40, 30), {});
}

TEST(Oracle, NegativeColourIsClampedInBoth) {
  TestScene scene = testing::random_scene(testing::radiance_layout(1), 60, {}, 8);
  for (std::size_t i = 0; i < scene.count; i += 2) scene.at(11, i) = -2.5F;
  expect_like_oracle(scene, testing::test_camera(40, 30), {});
}

/// Sources of every kind in the frames of objects that are turned, scaled and emissive; the last source has no row.
TestScene scene_of_lights(std::size_t count, std::uint32_t seed) {
  TestScene scene = testing::random_scene(testing::transfer_layout(), count, {}, seed);
  testing::add_sources(scene.state.light);
  testing::add_visibility(scene, 4, seed);
  scene.state.objects.at(7).scale = 1.7F;
  scene.state.objects.at(14).emissive = true;
  return scene;
}

TEST(Oracle, LightsOfEveryKind) {
  for (std::uint32_t seed = 1; seed <= 3; ++seed) {
    SCOPED_TRACE(seed);
    RenderOptions options;
    options.albedo = options.depth = true;
    expect_like_oracle(scene_of_lights(150, seed), testing::test_camera(43, 37), options);
  }
}

TEST(Oracle, EachSourceAlone) {
  const TestScene all = scene_of_lights(150, 21);
  const std::size_t count = all.state.light.sources.size();
  for (std::size_t j = 0; j < count; ++j) {
    SCOPED_TRACE(j);
    TestScene scene = all;
    Light& light = scene.state.light;
    light.sources = {all.state.light.sources[j]};
    light.sun_irradiance = glm::vec3(0);
    light.ambient_sh = {};
    expect_like_oracle(scene, testing::test_camera(43, 37), {});
  }
}

TEST(Oracle, SourcesWithoutVisibilityAreNotShadowed) {
  TestScene scene = scene_of_lights(120, 22);
  scene.light_visibility.clear();
  expect_like_oracle(scene, testing::test_camera(40, 30), {});
}

TEST(Oracle, ScaledObjects) {
  TestScene scene = testing::random_scene(testing::radiance_layout(3), 120, {.scale_low = 0.02F}, 23);
  scene.state.objects.at(7).scale = 0.4F;
  scene.state.objects.at(14).scale = 2.5F;
  RenderOptions options;
  options.depth = true;
  expect_like_oracle(scene, testing::test_camera(43, 37), options);
}

TEST(Oracle, EveryInstructionSetAgrees) {
  // Those that libs/raster is compiled for; the chosen one is forgotten so that the next call chooses again.
  for (const std::int64_t target : {std::int64_t{HWY_AVX3}, std::int64_t{HWY_AVX2}, std::int64_t{HWY_SCALAR}}) {
    if (target != HWY_SCALAR && (hwy::SupportedTargets() & target) == 0) continue;
    SCOPED_TRACE(hwy::TargetName(target));
    hwy::SetSupportedTargetsForTest(target | HWY_SCALAR);
    hwy::GetChosenTarget().DeInit();
    RenderOptions options;
    options.albedo = true;
    expect_like_oracle(testing::random_scene(testing::transfer_layout(), 70, {}, 9), testing::test_camera(29, 31),
                       options);
    expect_like_oracle(testing::random_scene(testing::radiance_layout(3), 70, {}, 9), testing::test_camera(29, 31), {});
    expect_like_oracle(scene_of_lights(70, 9), testing::test_camera(29, 31), options);
    hwy::SetSupportedTargetsForTest(0);
    hwy::GetChosenTarget().DeInit();
  }
}

}  // namespace
}  // namespace splatbus::raster
