#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "../gaussians/paged_model.h"
#include "raster/adam.h"
#include "scenes.h"

namespace splatbus::raster {
namespace {

using test::PagedModel;
using testing::TestScene;

class PagesTest : public ::testing::TestWithParam<ParameterLayout> {};

TEST_P(PagesTest, PictureGradientsAndStepAreThoseWithoutPages) {
  TestScene scene = testing::random_scene(GetParam(), 3000, {.scale_high = 0.15F}, 5);
  testing::add_sources(scene.state.light);
  scene.state.objects.at(7).scale = 1.3F;
  PagedModel paged(scene.view(), 700);
  GaussiansBuffer& flat = paged.planar;
  ASSERT_GE(paged.ranges.size(), 6U);
  // Visibility is by index, not at an offset.
  constexpr std::uint32_t kRows = 5;
  const std::size_t paged_count = paged.view().count, flat_count = flat.count();
  std::vector<std::uint8_t> paged_rows(kRows * paged_count), flat_rows(kRows * flat_count);
  paged.for_each([&](std::uint32_t i, std::size_t k) {
    for (std::size_t row = 0; row < kRows; ++row) {
      paged_rows[row * paged_count + i] = flat_rows[row * flat_count + k] =
          static_cast<std::uint8_t>((k * 37 + row * 101) % 256);
    }
  });
  GaussiansView in_pages = paged.view(), in_planes = flat.view();
  in_pages.visibility_u8 = paged_rows.data();
  in_pages.visibility_stride = paged_count;
  in_planes.visibility_u8 = flat_rows.data();
  in_planes.visibility_stride = flat_count;
  in_pages.visibility_rows = in_planes.visibility_rows = kRows;
  const Camera camera = testing::test_camera(70, 50);
  const auto rasterizer = make_cpu_rasterizer(2);
  const auto flat_rasterizer = make_cpu_rasterizer(2);
  const RenderOptions options{.depth = true};
  Render picture, flat_picture;
  rasterizer->render(in_pages, camera, scene.state, options, picture);
  flat_rasterizer->render(in_planes, camera, scene.state, options, flat_picture);
  EXPECT_EQ(picture.color.data, flat_picture.color.data);
  EXPECT_EQ(picture.depth.data, flat_picture.depth.data);

  rasterizer->forward(in_pages, camera, scene.state, options, picture);
  flat_rasterizer->forward(in_planes, camera, scene.state, options, flat_picture);
  RenderGradient gradient{.color = picture.color, .alpha = {}, .albedo = {}, .depth = picture.depth};
  ParameterGradient ours, theirs;
  ours.clear(paged.view());
  theirs.clear(flat.view());
  rasterizer->backward(gradient, ours);
  flat_rasterizer->backward(gradient, theirs);
  const int channels = GetParam().channels();
  paged.for_each([&](std::uint32_t i, std::size_t k) {
    ASSERT_EQ(ours.touched[i], theirs.touched[k]);
    ASSERT_EQ(ours.contribution[i], theirs.contribution[k]);
    for (std::size_t c = 0; c < static_cast<std::size_t>(channels); ++c) {
      ASSERT_NEAR(ours.values[c * ours.stride + i], theirs.values[c * theirs.stride + k], 1e-6F) << c;
    }
  });

  const std::vector<float> rates(static_cast<std::size_t>(channels), 0.01F);
  Adam adam, flat_adam;
  adam.resize(GetParam(), paged.view().count);
  flat_adam.resize(GetParam(), flat.count());
  ours.clear_statistics(paged.view());
  rasterizer->backward_step(gradient, rates, adam, paged.memory.data(), ours);
  flat_adam.step(flat.view(), flat.parameters.data(), theirs, rates, 2);
  float furthest = 0;
  paged.for_each([&](std::uint32_t i, std::size_t k) {
    for (int c = 0; c < channels; ++c) {
      const float before = scene.at(c, paged.source[k]);
      const float stepped = *paged.view().at(c, i);
      ASSERT_NEAR(stepped, flat.view().plane(c)[k], 1e-4F) << c;
      furthest = std::max(furthest, std::abs(stepped - before));
    }
  });
  EXPECT_NEAR(furthest, 0.01F, 1e-4F);
}

TEST_P(PagesTest, PagesOutsideOfTheFrustumAreLeftOutAndThePictureIsTheSame) {
  TestScene scene = testing::random_scene(GetParam(), 9000, {.spread = 6, .scale_low = 0.01F, .scale_high = 0.1F}, 8);
  scene.state.objects.at(7).scale = 1.6F;
  scene.state.objects.at(14).scale = 0.7F;
  PagedModel paged(scene.view(), 12, 2);
  const auto rasterizer = make_cpu_rasterizer(2);
  for (const float height : {0.4F, 3.0F}) {
    Camera camera = look_at({0.3F, height, 3.0F}, {0.05F, -0.1F, 0}, 80, 60, 0.5F);
    camera.cx += 9;
    Render all, selected;
    rasterizer->render(paged.view(), camera, scene.state, {}, all);
    rasterizer->render(paged.bounded_view(), camera, scene.state, {}, selected);
    EXPECT_EQ(all.color.data, selected.color.data);
    const FrustumCamera pinhole{camera.fx, camera.fy, camera.cx, camera.cy, 80, 60, camera.near_m, 0.3F, 1, 1};
    const auto ranges = select_ranges(paged.bounded_view(), pinhole, camera.world_from_camera, scene.state.objects);
    EXPECT_LT(ranges.size(), paged.ranges.size() / 2);
    EXPECT_GT(ranges.size(), 5U);
  }
}

TEST_P(PagesTest, AnObjectThatTheSceneDoesNotHaveIsHidden) {
  TestScene scene = testing::random_scene(GetParam(), 600, {.scale_high = 0.15F}, 6);
  const Camera camera = testing::test_camera(40, 40);
  const auto rasterizer = make_cpu_rasterizer(1);
  scene.state.objects.erase(14);
  TestScene without = scene;
  for (std::size_t i = 0; i < without.count; ++i) {
    if (without.object_id[i] == 14) without.at(ParameterLayout::kOpacityLogit, i) = -30;
  }
  PagedModel paged(scene.view(), 1000);
  Render hidden, paged_hidden, transparent;
  rasterizer->render(scene.view(), camera, scene.state, {}, hidden);
  rasterizer->render(paged.view(), camera, scene.state, {}, paged_hidden);
  rasterizer->render(without.view(), camera, scene.state, {}, transparent);
  EXPECT_EQ(hidden.color.data, transparent.color.data);
  EXPECT_EQ(paged_hidden.color.data, transparent.color.data);
}

INSTANTIATE_TEST_SUITE_P(Layouts, PagesTest, ::testing::Values(testing::transfer_layout(), testing::radiance_layout(2)),
                         [](const auto& of) {
                           return of.param.appearance == Appearance::Transfer ? "Transfer" : "Radiance";
                         });

/// A Gaussian whose page the test leaves out shows in no pixel, wherever it is and however large, at any scale of its
/// object.
TEST(PageFrustum, IsExactForSingleGaussians) {
  TestScene scene = testing::random_scene(
      testing::radiance_layout(0), 4000,
      {.spread = 5, .scale_low = 0.001F, .scale_high = 1.0F, .logit_low = 5, .logit_high = 9, .objects = false}, 11);
  const auto rasterizer = make_cpu_rasterizer(1);
  Camera camera = testing::test_camera(48, 32);
  camera.near_m = 0.2F;
  const float half_x = 0.5F * 48 / camera.fx, half_y = 0.5F * 32 / camera.fy;
  const FrustumCamera pinhole{camera.fx,
                              camera.fy,
                              camera.cx,
                              camera.cy,
                              48,
                              32,
                              camera.near_m,
                              0.3F,
                              std::max(camera.cx, 48 - camera.cx) / camera.fx + 0.3F * half_x,
                              std::max(camera.cy, 32 - camera.cy) / camera.fy + 0.3F * half_y};
  for (const float scale : {1.0F, 0.2F, 4.0F}) {
    SCOPED_TRACE(scale);
    scene.state.objects[3] = Rigid{glm::normalize(glm::quat(0.8F, 0.3F, -0.4F, 0.2F)), {0.2F, -0.1F, 0.3F}};
    scene.state.objects[3].scale = scale;
    std::size_t left_out = 0, invisible = 0;
    for (std::size_t i = 0; i < scene.count; ++i) {
      TestScene one(scene.layout, 1);
      one.object_id[0] = 3;
      one.state = scene.state;
      // As far about the camera as at a scale of 1.
      for (int c = 0; c < scene.layout.channels(); ++c) one.at(c, 0) = scene.at(c, i) / (c < 3 ? scale : 1);
      Render picture;
      rasterizer->render(one.view(), camera, one.state, {}, picture);
      const bool shows =
          std::any_of(picture.alpha.data.begin(), picture.alpha.data.end(), [](float a) { return a > 0; });
      GaussiansView view = one.view();
      const std::vector<IndexRange> range{{0, 1, 3}};
      const std::vector<PageBounds> bounds{bounds_of(view, range.front())};
      view.ranges = range;
      view.bounds = bounds;
      const bool selected = !select_ranges(view, pinhole, camera.world_from_camera, one.state.objects).empty();
      ASSERT_TRUE(selected || !shows) << i;
      left_out += selected ? 0 : 1;
      invisible += shows ? 0 : 1;
    }
    // It is not so careful that it leaves nothing out.
    EXPECT_GT(left_out, invisible / 2);
  }
}

}  // namespace
}  // namespace splatbus::raster
