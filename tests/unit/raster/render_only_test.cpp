#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include "raster/rasterizer.h"
#include "scenes.h"

namespace splatbus::raster {
namespace {

using testing::TestScene;

/// render(), which lists other tiles than forward() does, gives the same picture to the last bit.
void expect_same_picture(const TestScene& scene, const Camera& camera, const RenderOptions& options) {
  const auto rasterizer = make_cpu_rasterizer(2);
  Render kept, rendered;
  rasterizer->forward(scene.view(), camera, scene.state, options, kept);
  rasterizer->render(scene.view(), camera, scene.state, options, rendered);
  EXPECT_EQ(kept.color.data, rendered.color.data);
  EXPECT_EQ(kept.alpha.data, rendered.alpha.data);
  EXPECT_EQ(kept.albedo.data, rendered.albedo.data);
  EXPECT_EQ(kept.depth.data, rendered.depth.data);
}

TEST(RenderOnly, SamePictureOfEverySize) {
  for (const auto& [width, height] : std::vector<std::pair<std::uint32_t, std::uint32_t>>{
           {1, 1}, {3, 70}, {8, 8}, {15, 17}, {16, 16}, {24, 40}, {33, 64}, {130, 101}}) {
    // From Gaussians of a block to some that cover the picture.
    for (const float scale : {0.02F, 0.1F, 0.5F}) {
      SCOPED_TRACE(::testing::Message() << width << "x" << height << ", scales to " << scale);
      const TestScene scene =
          testing::random_scene(testing::transfer_layout(), 3000, {.scale_low = scale / 4, .scale_high = scale}, 51);
      expect_same_picture(scene, testing::test_camera(width, height), {.albedo = true, .depth = true});
    }
  }
}

TEST(RenderOnly, SamePictureOfEveryAppearance) {
  const Camera camera = testing::test_camera(77, 61);
  for (const ParameterLayout& layout :
       {testing::transfer_layout(), testing::radiance_layout(0), testing::radiance_layout(1),
        testing::radiance_layout(2), testing::radiance_layout(3)}) {
    for (const bool objects : {false, true}) {
      SCOPED_TRACE(::testing::Message() << "degree " << layout.sh_degree << ", objects " << objects);
      // More than a batch of vectors, and not a whole number of them.
      TestScene scene =
          testing::random_scene(layout, 5003, {.scale_low = 0.02F, .scale_high = 0.1F, .objects = objects}, 52);
      for (std::size_t i = 0; i < scene.count; i += 3) scene.flags[i] = kFrozen;
      for (const bool depth : {false, true}) expect_same_picture(scene, camera, {.depth = depth});
      expect_same_picture(scene, camera, {.antialias = false, .blur_px2 = 0.1F});
    }
  }
}

TEST(RenderOnly, SamePictureOfOpaqueLayers) {
  // Pixels end at different depths within a tile, most of them long before its list does.
  const TestScene scene = testing::random_scene(
      testing::radiance_layout(3), 20000,
      {.scale_low = 0.01F, .scale_high = 0.06F, .logit_low = 2, .logit_high = 9, .objects = false}, 53);
  expect_same_picture(scene, testing::test_camera(150, 90), {});
}

TEST(RenderOnly, BadGaussiansAreLeftOut) {
  for (const ParameterLayout& layout : {testing::radiance_layout(3), testing::transfer_layout()}) {
    TestScene scene = testing::random_scene(layout, 500, {}, 54);
    for (int channel = 0; channel < scene.layout.channels(); ++channel) {
      scene.at(channel, static_cast<std::size_t>(channel) * 7) = channel % 2 == 0 ? NAN : INFINITY;
    }
    const Camera camera = testing::test_camera(50, 50);
    const RenderOptions options{.albedo = true, .depth = true};
    Render rendered;
    make_cpu_rasterizer(2)->render(scene.view(), camera, scene.state, options, rendered);
    for (const Image* image : {&rendered.color, &rendered.alpha, &rendered.albedo, &rendered.depth}) {
      EXPECT_TRUE(
          std::all_of(image->data.begin(), image->data.end(), [](float value) { return std::isfinite(value); }));
    }
    expect_same_picture(scene, camera, options);
  }
}

TEST(RenderOnly, SamePictureOfGaussiansLargerThanIt) {
  // Some begin left of and above the picture, and all end beyond it.
  const TestScene scene = testing::random_scene(
      testing::radiance_layout(1), 300, {.scale_low = 2, .scale_high = 1e6F, .logit_low = -4, .logit_high = 0}, 55);
  const Camera camera = testing::test_camera(75, 43);
  expect_same_picture(scene, camera, {.depth = true});
  Render rendered;
  make_cpu_rasterizer(2)->render(scene.view(), camera, scene.state, {}, rendered);
  EXPECT_GT(*std::min_element(rendered.alpha.data.begin(), rendered.alpha.data.end()), 0.1F)
      << "the test shows nothing";
}

TEST(RenderOnly, SamePictureOfNothing) {
  const TestScene scene = testing::random_scene(testing::radiance_layout(1), 0, {}, 56);
  expect_same_picture(scene, testing::test_camera(33, 17), {.depth = true});
  const TestScene some = testing::random_scene(testing::radiance_layout(1), 50, {.scale_low = 2, .scale_high = 9}, 57);
  expect_same_picture(some, testing::test_camera(0, 40), {.depth = true});
  expect_same_picture(some, testing::test_camera(40, 0), {.depth = true});
}

}  // namespace
}  // namespace splatbus::raster
