#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "scenes.h"

namespace splatbus::raster {
namespace {

using testing::TestScene;

/// One isotropic Gaussian at a pixel's centre on the optical axis, unlit albedo 1 under white ambient light.
TestScene single_gaussian(float scale, float logit) {
  TestScene scene(testing::transfer_layout(), 1);
  for (int c = 3; c < 6; ++c) scene.at(c, 0) = std::log(scale);
  scene.at(6, 0) = 2;  // not normalised
  scene.at(10, 0) = logit;
  for (int c = 11; c < 14; ++c) scene.at(c, 0) = 0.25F * static_cast<float>(c - 10);
  scene.normal[scene.stride] = 1;
  for (int c = 0; c < 3; ++c) scene.state.light.ambient_sh[0][c] = 1 / 0.28209479F;
  return scene;
}

Camera axial_camera(std::uint32_t side) {
  Camera camera = look_at({0, 0, 4}, {0, 0, 0}, side, side, 1.0F);
  camera.fx = camera.fy = 20;
  const std::uint32_t middle = side / 2;
  camera.cx = camera.cy = static_cast<float>(middle) + 0.5F;
  return camera;
}

TEST(Render, OneGaussianHasItsClosedForm) {
  const TestScene scene = single_gaussian(0.4F, 1.0F);
  const Camera camera = axial_camera(21);
  RenderOptions options;
  options.albedo = options.depth = true;
  Render render;
  make_cpu_rasterizer(1)->render(scene.view(), camera, scene.state, options, render);

  const double sharp = 0.4 * 20 / 4 * 0.4 * 20 / 4, blurred = sharp + 0.3;  // pixels squared
  const double opacity = 1 / (1 + std::exp(-1.0)) * sharp / blurred;
  for (int y = 0; y < 21; ++y) {
    for (int x = 0; x < 21; ++x) {
      double alpha = opacity * std::exp(-0.5 * ((x - 10) * (x - 10) + (y - 10) * (y - 10)) / blurred);
      if (alpha < 1.0 / 255) alpha = 0;
      const std::size_t i = static_cast<std::size_t>(y) * 21 + static_cast<std::size_t>(x);
      EXPECT_NEAR(render.alpha.data[i], alpha, 2e-6);
      EXPECT_NEAR(render.depth.data[i], 4 * alpha, 1e-5);
      for (std::uint32_t c = 0; c < 3; ++c) {
        EXPECT_NEAR(render.color.plane(c)[i], 0.25 * (c + 1) * alpha, 2e-6);
        EXPECT_NEAR(render.albedo.plane(c)[i], 0.25 * (c + 1) * alpha, 2e-6);
      }
    }
  }
}

TEST(Render, NearerGaussianHidesTheFarther) {
  TestScene scene(testing::radiance_layout(0), 2);
  for (std::size_t i = 0; i < 2; ++i) {
    for (int c = 3; c < 6; ++c) scene.at(c, i) = std::log(0.5F);
    scene.at(6, i) = 1;
    scene.at(10, i) = 20;  // clamped to 0.999
  }
  scene.at(2, 0) = -1;  // farther, white
  scene.at(11, 0) = scene.at(12, 0) = scene.at(13, 0) = 0.5F / 0.28209479F;
  scene.at(11, 1) = scene.at(12, 1) = scene.at(13, 1) = -0.5F / 0.28209479F;  // nearer, black
  scene.state.light.background = glm::vec3(1);
  Render render;
  RenderOptions options;
  options.antialias = false;
  make_cpu_rasterizer(1)->render(scene.view(), axial_camera(9), scene.state, options, render);
  const std::size_t centre = 4 * 9 + 4;
  EXPECT_NEAR(render.color.data[centre], 0.001F, 1e-5F);  // what 0.999 lets through of white
}

TEST(Render, BackgroundIsInTheSpaceOfTheAppearance) {
  for (const ParameterLayout& layout : {testing::transfer_layout(), testing::radiance_layout(1)}) {
    TestScene scene(layout, 0);
    scene.state.light.background = {0.2F, 0.5F, 0.0F};
    Render render;
    make_cpu_rasterizer(1)->render(scene.view(), axial_camera(5), scene.state, {}, render);
    const bool linear = layout.appearance == Appearance::Transfer;
    EXPECT_FLOAT_EQ(render.color.plane(0)[7], linear ? 0.2F : srgb_from_linear(0.2F));
    EXPECT_FLOAT_EQ(render.color.plane(1)[7], linear ? 0.5F : srgb_from_linear(0.5F));
    EXPECT_FLOAT_EQ(render.alpha.data[7], 0);
    EXPECT_TRUE(render.albedo.data.empty());
    EXPECT_TRUE(render.depth.data.empty());
  }
}

TEST(Render, SameImageWhateverTheThreadsAndWhetherKept) {
  const TestScene scene =
      testing::random_scene(testing::transfer_layout(), 20000, {.scale_low = 0.005F, .scale_high = 0.05F}, 4);
  const Camera camera = testing::test_camera(101, 83);
  Render one, four, kept;
  make_cpu_rasterizer(1)->render(scene.view(), camera, scene.state, {}, one);
  make_cpu_rasterizer(4)->render(scene.view(), camera, scene.state, {}, four);
  make_cpu_rasterizer(3)->forward(scene.view(), camera, scene.state, {}, kept);
  EXPECT_EQ(one.color.data, four.color.data);
  EXPECT_EQ(one.color.data, kept.color.data);
  EXPECT_EQ(one.alpha.data, kept.alpha.data);
}

TEST(Render, MovedObjectLooksLikeMovedWorld) {
  // All Gaussians in one moved object under no light but SH seen from a camera moved along: the same picture.
  TestScene scene = testing::random_scene(testing::radiance_layout(3), 300, {.objects = false}, 12);
  const Camera camera = testing::test_camera(48, 40);
  const auto rasterizer = make_cpu_rasterizer(2);
  Render expected, moved;
  rasterizer->render(scene.view(), camera, scene.state, {}, expected);
  std::fill(scene.object_id.begin(), scene.object_id.end(), 3U);
  const Rigid motion{glm::normalize(glm::quat(0.7F, -0.2F, 0.4F, 0.3F)), {1, -2, 0.5F}};
  scene.state.objects[3] = motion;
  Camera followed = camera;
  followed.world_from_camera = motion * camera.world_from_camera;
  rasterizer->render(scene.view(), followed, scene.state, {}, moved);
  for (std::size_t i = 0; i < expected.color.data.size(); ++i) {
    ASSERT_NEAR(moved.color.data[i], expected.color.data[i], 2e-4F);
  }
}

TEST(Backward, BatchAddsUpAndActiveChannelsLimitIt) {
  const TestScene scene = testing::random_scene(testing::transfer_layout(), 200, {}, 21);
  const Camera camera = testing::test_camera(32, 32);
  const auto rasterizer = make_cpu_rasterizer(2);
  Render render;
  RenderGradient gradient;
  gradient.color = Image(32, 32, 3);
  std::fill(gradient.color.data.begin(), gradient.color.data.end(), 1.0F);
  ParameterGradient once, twice, some;
  once.clear(scene.view());
  twice.clear(scene.view());
  some.active_channels = 14;
  some.clear(scene.view());
  rasterizer->forward(scene.view(), camera, scene.state, {}, render);
  rasterizer->backward(gradient, once);
  rasterizer->backward(gradient, twice);
  rasterizer->backward(gradient, twice);
  rasterizer->backward(gradient, some);
  for (std::size_t i = 0; i < once.values.size(); ++i) {
    ASSERT_FLOAT_EQ(twice.values[i], 2 * once.values[i]);
    ASSERT_EQ(some.values[i], i < 14 * scene.stride ? once.values[i] : 0);
  }
  EXPECT_EQ(some.active_channels, 14);
}

TEST(Backward, ClearLeavesNothingOfTheLastBatch) {
  const TestScene scene = testing::random_scene(testing::transfer_layout(), 50, {}, 23);
  ParameterGradient gradient;
  gradient.clear(scene.view(), 1);
  std::fill(gradient.values.begin(), gradient.values.end(), 1.0F);
  std::fill(gradient.touched.begin(), gradient.touched.end(), std::uint8_t{1});
  gradient.written.push_back({0, 50});
  gradient.clear(scene.view(), 2);
  ASSERT_EQ(gradient.values.size(), static_cast<std::size_t>(scene.layout.channels()) * scene.stride);
  for (std::size_t i = 0; i < gradient.values.size(); ++i) {
    if (i % scene.stride < scene.count) {
      ASSERT_EQ(gradient.values[i], 0);
    }
  }
  EXPECT_EQ(std::count(gradient.touched.begin(), gradient.touched.end(), 1), 0);
}

TEST(Backward, StatisticsSayWhatWasSeen) {
  TestScene scene = testing::random_scene(testing::transfer_layout(), 2, {.objects = false}, 22);
  for (int c = 0; c < 3; ++c) scene.at(c, 0) = 0;
  scene.at(10, 0) = 3;
  scene.at(2, 1) = 50;  // behind the camera
  const Camera camera = testing::test_camera(32, 32);
  const auto rasterizer = make_cpu_rasterizer(1);
  Render render;
  rasterizer->forward(scene.view(), camera, scene.state, {}, render);
  RenderGradient gradient;
  gradient.color = Image(32, 32, 3);
  for (std::size_t i = 0; i < std::size_t{32} * 32; ++i) gradient.color.data[i] = static_cast<float>(i % 32);
  ParameterGradient out;
  out.clear(scene.view());
  rasterizer->backward(gradient, out);
  EXPECT_NE(out.touched[0], 0);
  EXPECT_EQ(out.touched[1], 0);
  EXPECT_GT(out.mean2d_norm[0], 0);
  const float largest = *std::max_element(render.alpha.data.begin(), render.alpha.data.end());
  EXPECT_NEAR(out.contribution[0], largest, 1e-5F);
}

}  // namespace
}  // namespace splatbus::raster
