// The CUDA backend against the CPU one, whose gradients are checked against autograd: same pictures, same gradients.
#include "../raster/lights.h"
#include "cuda_rasterizer.h"
#include "cuda_scenes.h"

namespace splatbus::raster::testing {
namespace {

class CudaParity : public CudaTest, public ::testing::WithParamInterface<Case> {};

TEST_P(CudaParity, PicturesAndGradientsMatchTheCpuBackend) {
  const Case& c = GetParam();
  GaussiansBuffer model = random_model(c, 11);
  SceneState scene = random_scene(c.objects);
  std::vector<std::uint8_t> rows;
  if (c.lights) {
    add_sources(scene.light);
    scene.objects.at(7).scale = 1.4F;
    scene.objects[9].emissive = true;
    for (std::size_t i = 1; i < model.count(); i += 5) model.object_id[i] = 9;
    rows = random_bytes(4 * (model.count() + 3), 3);
  }
  GaussiansView view = model.view();
  if (c.lights) {
    view.visibility_u8 = rows.data();
    view.visibility_stride = model.count() + 3;
    view.visibility_rows = 4;  // the last source has none
  }
  const Camera camera = look_at({0.5F, 1.5F, 5.0F}, {0, 0, 0}, c.width, c.height, 1.0F);
  const bool transfer = c.layout.appearance == Appearance::Transfer;
  const RenderOptions options{.antialias = c.antialias, .albedo = transfer, .depth = c.depth};
  const auto cpu = make_cpu_rasterizer(2);
  const auto gpu = make_cuda_rasterizer();
  Render expected, actual;
  cpu->forward(view, camera, scene, options, expected);
  gpu->forward(view, camera, scene, options, actual);
  EXPECT_LT(largest_difference(actual.color, expected.color), 1e-3);
  EXPECT_LT(largest_difference(actual.alpha, expected.alpha), 1e-3);
  ASSERT_EQ(actual.albedo.data.size(), expected.albedo.data.size());
  EXPECT_LT(largest_difference(actual.albedo, expected.albedo), 1e-3);
  ASSERT_EQ(actual.depth.data.size(), expected.depth.data.size());
  EXPECT_LT(largest_difference(actual.depth, expected.depth), 5e-3) << "metres";  // weights of 1e-3 at 5 m

  std::mt19937 random(5);
  RenderGradient gradient;
  gradient.color = random_image(c.width, c.height, 3, random);
  if (transfer) gradient.albedo = random_image(c.width, c.height, 3, random);
  if (c.depth) gradient.depth = random_image(c.width, c.height, 1, random);
  if (c.alpha) gradient.alpha = random_image(c.width, c.height, 1, random);
  ParameterGradient expected_gradient, actual_gradient;
  expected_gradient.clear(view);
  actual_gradient.clear(view);
  cpu->backward(gradient, expected_gradient);
  gpu->backward(gradient, actual_gradient);
  // A pixel on the edge of 1/255 may fall either way.
  std::size_t differing = 0;
  for (std::size_t i = 0; i < model.count(); ++i) {
    differing += (actual_gradient.touched[i] != 0) != (expected_gradient.touched[i] != 0) ? 1 : 0;
  }
  EXPECT_LE(differing, model.count() / 200) << "touched";
  const int appearance_end = c.layout.channels();
  EXPECT_LT(relative_error(actual_gradient, expected_gradient, 0, 3), 1e-3) << "mean";
  EXPECT_LT(relative_error(actual_gradient, expected_gradient, 3, 6), 1e-3) << "log scale";
  EXPECT_LT(relative_error(actual_gradient, expected_gradient, 6, 10), 1e-3) << "rotation";
  EXPECT_LT(relative_error(actual_gradient, expected_gradient, 10, 11), 1e-3) << "opacity";
  EXPECT_LT(relative_error(actual_gradient, expected_gradient, 11, 14), 1e-3) << "albedo or DC";
  if (appearance_end > 14) {
    EXPECT_LT(relative_error(actual_gradient, expected_gradient, 14, appearance_end), 1e-3) << "rest";
  }
  EXPECT_LT(relative_error(actual_gradient.mean2d_norm, expected_gradient.mean2d_norm), 1e-3) << "projected mean";
  for (std::size_t i = 0; i < model.count(); ++i) {
    EXPECT_NEAR(actual_gradient.contribution[i], expected_gradient.contribution[i], 2e-3F) << i;
  }
}

INSTANTIATE_TEST_SUITE_P(
    Cases, CudaParity,
    ::testing::Values(Case{"Transfer", {Appearance::Transfer, 0}, 400, 96, 64, true, true, -2.0F},
                      Case{"TransferClassic", {Appearance::Transfer, 0}, 400, 70, 50, false, false, -2.0F},
                      Case{"TransferSmall", {Appearance::Transfer, 0}, 1500, 96, 96, true, true, -4.0F},
                      Case{"Radiance0", {Appearance::Radiance, 0}, 500, 64, 64, true, false, -2.0F},
                      Case{"Radiance3", {Appearance::Radiance, 3}, 500, 100, 80, true, true, -2.5F},
                      // Occluded by their neighbours, mostly.
                      Case{"Dense", {Appearance::Radiance, 0}, 3000, 32, 32, true, false, -1.5F},
                      Case{"Huge", {Appearance::Radiance, 1}, 60, 64, 64, true, false, 0.5F},
                      // So faint that a patch's list has several segments.
                      Case{"Faint", {Appearance::Radiance, 0}, 3000, 24, 24, true, false, -1.5F, -4.0F}),
    case_name);

// The same through depth and alpha, each alone and together.
INSTANTIATE_TEST_SUITE_P(
    Depth, CudaParity,
    ::testing::Values(
        Case{"Transfer", {Appearance::Transfer, 0}, 400, 70, 50, true, true, -2.0F, 0.0F, true, true},
        Case{"TransferDepthAlone", {Appearance::Transfer, 0}, 300, 48, 40, false, false, -2.0F, 0.0F, true, false},
        Case{"TransferAlphaAlone", {Appearance::Transfer, 0}, 300, 48, 40, true, true, -2.0F, 0.0F, false, true},
        Case{"TransferFaint", {Appearance::Transfer, 0}, 3000, 24, 24, true, false, -1.5F, -4.0F, true, true},
        Case{"Radiance", {Appearance::Radiance, 2}, 400, 70, 50, true, true, -2.0F, 0.0F, true, true},
        Case{"RadianceAlphaAlone", {Appearance::Radiance, 0}, 300, 48, 40, true, false, -2.0F, 0.0F, false, true},
        Case{"RadianceFaint", {Appearance::Radiance, 0}, 3000, 24, 24, true, true, -1.5F, -4.0F, true, true}),
    case_name);

INSTANTIATE_TEST_SUITE_P(
    Lights, CudaParity,
    ::testing::Values(
        Case{"Transfer", {Appearance::Transfer, 0}, 500, 96, 64, true, true, -2.0F, 0.0F, false, false, true},
        Case{"TransferExtra", {Appearance::Transfer, 0}, 500, 70, 50, true, true, -2.0F, 0.0F, true, true, true},
        Case{"Radiance", {Appearance::Radiance, 3}, 400, 70, 50, true, true, -2.0F, 0.0F, true, false, true}),
    case_name);

TEST_F(CudaTest, StatisticsOfASharedGradientAdd) {
  const Case c{"", {Appearance::Radiance, 0}, 100, 40, 32, true, false, -2.0F};
  const GaussiansBuffer model = random_model(c, 29);
  const SceneState scene = random_scene(false);
  std::mt19937 random(5);
  const auto cpu = make_cpu_rasterizer(1), gpu = make_cuda_rasterizer();
  ParameterGradient expected, actual;
  expected.clear(model.view());
  actual.clear(model.view());
  for (const float x : {0.5F, -1.0F}) {
    RenderGradient gradient;
    gradient.color = random_image(c.width, c.height, 3, random);
    Render picture;
    for (const bool on_gpu : {false, true}) {
      Rasterizer& rasterizer = on_gpu ? *gpu : *cpu;
      const Camera camera = look_at({x, 1.5F, 5.0F}, {0, 0, 0}, c.width, c.height, 1.0F);
      rasterizer.forward(model.view(), camera, scene, {}, picture);
      rasterizer.backward(gradient, on_gpu ? actual : expected);
    }
  }
  EXPECT_LT(relative_error(actual.mean2d_norm, expected.mean2d_norm), 1e-3);
  EXPECT_LT(relative_error(actual.contribution, expected.contribution), 1e-3);
}

TEST_F(CudaTest, WhatIsNotFiniteIsNotSeen) {
  for (const Appearance appearance : {Appearance::Transfer, Appearance::Radiance}) {
    const Case c{"", {appearance, 0}, 200, 40, 32, true, false, -1.5F};
    GaussiansBuffer model = random_model(c, 37);
    for (std::size_t i = 0; i < model.count(); i += 5) {
      model.parameters[11 * model.stride() + i] = i % 2 == 0 ? NAN : INFINITY;
    }
    const Camera camera = look_at({0.5F, 1.5F, 5.0F}, {0, 0, 0}, c.width, c.height, 1.0F);
    const RenderOptions options{.albedo = appearance == Appearance::Transfer, .depth = true};
    Render expected, actual;
    make_cpu_rasterizer(1)->render(model.view(), camera, random_scene(false), options, expected);
    make_cuda_rasterizer()->render(model.view(), camera, random_scene(false), options, actual);
    EXPECT_LT(largest_difference(actual.color, expected.color), 1e-3);
    EXPECT_LT(largest_difference(actual.albedo, expected.albedo), 1e-3);
    EXPECT_LT(largest_difference(actual.depth, expected.depth), 5e-3);
  }
}

TEST_F(CudaTest, NormalsAndVisibilityMayBeMissing) {
  const Case c{"", {Appearance::Transfer, 0}, 300, 48, 40, true, true, -2.0F};
  const GaussiansBuffer model = random_model(c, 23);
  const SceneState scene = random_scene(true);
  const Camera camera = look_at({0.5F, 1.5F, 5.0F}, {0, 0, 0}, c.width, c.height, 1.0F);
  GaussiansView view = model.view();
  view.normal = nullptr;
  view.visibility = nullptr;
  Render expected, actual;
  make_cpu_rasterizer(1)->render(view, camera, scene, {}, expected);
  make_cuda_rasterizer()->render(view, camera, scene, {}, actual);
  EXPECT_LT(largest_difference(actual.color, expected.color), 1e-3);
}

}  // namespace
}  // namespace splatbus::raster::testing
