#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <stdexcept>

#include "raster/adam.h"
#include "raster/loss.h"
#include "scenes.h"

namespace splatbus::raster {
namespace {

using testing::TestScene;

void expect_finite(const std::vector<float>& values) {
  for (const float value : values) ASSERT_TRUE(std::isfinite(value));
}

/// A whole training step; everything that comes out must be finite.
void expect_sane_step(const TestScene& scene, const Camera& camera) {
  const auto rasterizer = make_cpu_rasterizer(2);
  RenderOptions options;
  options.albedo = options.depth = true;
  Render render;
  rasterizer->forward(scene.view(), camera, scene.state, options, render);
  ASSERT_EQ(render.color.data.size(), std::size_t{3} * camera.width * camera.height);
  expect_finite(render.color.data);
  expect_finite(render.alpha.data);
  expect_finite(render.depth.data);
  const std::vector<std::uint8_t> target(std::size_t{4} * camera.width * camera.height, 90);
  RenderGradient gradient;
  EXPECT_TRUE(std::isfinite(image_loss(render.color, target.data(), {}, gradient.color)));
  ParameterGradient out;
  out.clear(scene.view());
  rasterizer->backward(gradient, out);
  expect_finite(out.values);
  expect_finite(out.mean2d_norm);
}

TEST(Robustness, OneBadGaussianPoisonsNothing) {
  const float bad_values[] = {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(),
                              -std::numeric_limits<float>::infinity(), std::numeric_limits<float>::max(), -1e30F};
  for (const ParameterLayout& layout : {testing::transfer_layout(), testing::radiance_layout(2)}) {
    for (int channel = 0; channel < layout.channels(); ++channel) {
      for (const float bad : bad_values) {
        SCOPED_TRACE(::testing::Message() << "channel " << channel << " = " << bad);
        TestScene scene = testing::random_scene(layout, 33, {}, 31);
        scene.at(channel, 17) = bad;
        expect_sane_step(scene, testing::test_camera(20, 20));
      }
    }
  }
}

TEST(Robustness, BadGaussianLeavesTheOthersPictureAsItIs) {
  TestScene scene = testing::random_scene(testing::transfer_layout(), 50, {}, 32);
  const Camera camera = testing::test_camera(30, 30);
  const auto rasterizer = make_cpu_rasterizer(1);
  Render expected, render;
  scene.at(10, 20) = -100;  // as good as absent
  rasterizer->render(scene.view(), camera, scene.state, {}, expected);
  scene.at(1, 20) = std::numeric_limits<float>::quiet_NaN();
  rasterizer->render(scene.view(), camera, scene.state, {}, render);
  EXPECT_EQ(render.color.data, expected.color.data);
}

TEST(Robustness, ColumnsBeyondTheCountAreNotRead) {
  TestScene scene = testing::random_scene(testing::transfer_layout(), 41, {}, 33);
  const Camera camera = testing::test_camera(24, 24);
  const auto rasterizer = make_cpu_rasterizer(1);
  Render expected, render;
  rasterizer->render(scene.view(), camera, scene.state, {}, expected);
  for (int c = 0; c < scene.layout.channels(); ++c) {
    for (std::size_t i = scene.count; i < scene.stride; ++i) scene.at(c, i) = std::numeric_limits<float>::quiet_NaN();
  }
  rasterizer->render(scene.view(), camera, scene.state, {}, render);
  EXPECT_EQ(render.color.data, expected.color.data);
}

TEST(Robustness, AnySizeOfPictureAndModel) {
  for (const auto& [width, height] : std::vector<std::pair<std::uint32_t, std::uint32_t>>{
           {0, 0}, {0, 5}, {5, 0}, {1, 1}, {1, 40}, {9, 1}, {8, 8}, {17, 15}, {33, 64}}) {
    for (const std::size_t count : {0U, 1U, 15U, 16U, 17U, 2049U}) {
      SCOPED_TRACE(::testing::Message() << width << "x" << height << ", " << count << " Gaussians");
      const TestScene scene = testing::random_scene(testing::transfer_layout(), count, {.spread = 0.5F}, 34);
      Camera camera = testing::test_camera(16, 16);
      camera.width = width;
      camera.height = height;
      camera.cx = static_cast<float>(width) / 2;
      camera.cy = static_cast<float>(height) / 2;
      expect_sane_step(scene, camera);
    }
  }
}

TEST(Robustness, OptionalPlanesMayBeAbsent) {
  const TestScene scene = testing::random_scene(testing::transfer_layout(), 60, {.objects = false}, 35);
  GaussiansView view = scene.view();
  view.normal = nullptr;
  view.visibility = nullptr;
  view.object_id = nullptr;
  view.flags = nullptr;
  Render render;
  const auto rasterizer = make_cpu_rasterizer(1);
  rasterizer->forward(view, testing::test_camera(16, 16), scene.state, {}, render);
  expect_finite(render.color.data);
  ParameterGradient out;
  out.clear(view);
  RenderGradient gradient;
  gradient.alpha = render.alpha;
  rasterizer->backward(gradient, out);
  expect_finite(out.values);
}

TEST(Robustness, MisuseIsNamed) {
  const TestScene scene = testing::random_scene(testing::transfer_layout(), 10, {}, 36);
  const auto rasterizer = make_cpu_rasterizer(1);
  Render render;
  Camera camera = testing::test_camera(16, 16);
  camera.role = CameraRole::Light;
  EXPECT_THROW(rasterizer->render(scene.view(), camera, scene.state, {}, render), std::invalid_argument);
  camera.role = CameraRole::Reference;
  rasterizer->forward(scene.view(), camera, scene.state, {}, render);
  ParameterGradient out;
  EXPECT_THROW(rasterizer->backward({}, out), std::invalid_argument);  // not cleared
  out.clear(scene.view());
  RenderGradient wrong;
  wrong.color = Image(15, 16, 3);
  EXPECT_THROW(rasterizer->backward(wrong, out), std::invalid_argument);
  rasterizer->render(scene.view(), camera, scene.state, {}, render);  // keeps nothing
  EXPECT_THROW(rasterizer->backward({}, out), std::invalid_argument);
  Adam adam;
  std::vector<float> parameters = scene.parameters;
  EXPECT_THROW(adam.step(scene.view(), parameters.data(), out, std::vector<float>(41, 0.1F), 1), std::invalid_argument);
}

}  // namespace
}  // namespace splatbus::raster
