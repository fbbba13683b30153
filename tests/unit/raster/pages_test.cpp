#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <tuple>

#include "raster/adam.h"
#include "scenes.h"

namespace splatbus::raster {
namespace {

using testing::TestScene;

/// The Gaussians of a scene in pages: those of one object together, cube by cube, some pages full and some not. What
/// lies beyond a page's Gaussians is garbage.
struct PagedScene {
  ParameterLayout layout;
  std::size_t page_floats = 0;
  std::vector<float> memory;
  std::vector<IndexRange> ranges;
  std::vector<PageBounds> bounds;
  std::vector<std::uint32_t> source;  ///< of each index in `ranges`, in order: the scene's Gaussian

  /// Cubes of 2 m one after the other, so that pages are compact.
  static int cell(TestScene& scene, std::uint32_t i) {
    const auto along = [&](int axis) { return static_cast<int>(std::floor(scene.at(axis, i) / 2)) + 8; };
    return (along(0) * 16 + along(1)) * 16 + along(2);
  }

  PagedScene(TestScene& scene, std::size_t fill) : layout(scene.layout) {
    source.resize(scene.count);
    std::iota(source.begin(), source.end(), 0U);
    std::sort(source.begin(), source.end(), [&](std::uint32_t a, std::uint32_t b) {
      return std::tuple(scene.object_id[a], cell(scene, a), a) < std::tuple(scene.object_id[b], cell(scene, b), b);
    });
    const auto channels = static_cast<std::size_t>(layout.channels());
    page_floats = (channels + 4) * kPageLanes;  // parameters, normal, visibility
    for (std::size_t k = 0; k < source.size();) {
      const std::uint32_t frame_id = scene.object_id[source[k]];
      const auto page = static_cast<std::uint32_t>(memory.size() / page_floats);
      memory.resize(memory.size() + page_floats, std::numeric_limits<float>::quiet_NaN());
      IndexRange range{page * kPageLanes, 0, frame_id};
      float* const block = memory.data() + page * page_floats;
      for (; k < source.size() && range.count < fill && scene.object_id[source[k]] == frame_id; ++k, ++range.count) {
        const auto put = [&](std::size_t channel, float value) { block[channel * kPageLanes + range.count] = value; };
        for (std::size_t c = 0; c < channels; ++c) put(c, scene.at(static_cast<int>(c), source[k]));
        for (std::size_t c = 0; c < 3; ++c) put(channels + c, scene.normal[c * scene.stride + source[k]]);
        put(channels + 3, scene.visibility[source[k]]);
      }
      ranges.push_back(range);
    }
    for (const IndexRange& range : ranges) bounds.push_back(bounds_of(view(), range));
  }

  [[nodiscard]] GaussiansView view() const {
    const auto channels = static_cast<std::size_t>(layout.channels());
    GaussiansView out;
    out.layout = layout;
    out.count = memory.size() / page_floats * kPageLanes;
    out.stride = kPageLanes;
    out.page_shift = kPageShift;
    out.page_stride = page_floats;
    out.ranges = ranges;
    out.parameters = memory.data();
    out.normal = memory.data() + channels * kPageLanes;
    out.visibility = memory.data() + (channels + 3) * kPageLanes;
    return out;
  }
  [[nodiscard]] GaussiansView bounded_view() const {
    GaussiansView out = view();
    out.bounds = bounds;
    return out;
  }
  /// The same Gaussians without pages, in the order of their indices.
  [[nodiscard]] TestScene in_order(const TestScene& scene) const {
    TestScene out(layout, source.size());
    out.state = scene.state;
    TestScene from = scene;
    for (std::size_t k = 0; k < source.size(); ++k) {
      for (int c = 0; c < layout.channels(); ++c) out.at(c, k) = from.at(c, source[k]);
      for (std::size_t c = 0; c < 3; ++c) out.normal[c * out.stride + k] = scene.normal[c * scene.stride + source[k]];
      out.visibility[k] = scene.visibility[source[k]];
      out.object_id[k] = scene.object_id[source[k]];
    }
    return out;
  }
  /// Calls visit(index, k) for each Gaussian, k as in `source`.
  template <class Visit>
  void for_each(const Visit& visit) const {
    std::size_t k = 0;
    for (const IndexRange& range : ranges) {
      for (std::uint32_t i = range.first; i < range.first + range.count; ++i) visit(i, k++);
    }
  }
};

class PagesTest : public ::testing::TestWithParam<ParameterLayout> {};

TEST_P(PagesTest, PictureGradientsAndStepAreThoseWithoutPages) {
  TestScene scene = testing::random_scene(GetParam(), 3000, {.scale_high = 0.15F}, 5);
  PagedScene paged(scene, 700);
  TestScene flat = paged.in_order(scene);
  ASSERT_GE(paged.ranges.size(), 6U);
  const Camera camera = testing::test_camera(70, 50);
  const auto rasterizer = make_cpu_rasterizer(2);
  const auto flat_rasterizer = make_cpu_rasterizer(2);
  const RenderOptions options{.depth = true};
  Render picture, flat_picture;
  rasterizer->render(paged.view(), camera, scene.state, options, picture);
  flat_rasterizer->render(flat.view(), camera, scene.state, options, flat_picture);
  EXPECT_EQ(picture.color.data, flat_picture.color.data);
  EXPECT_EQ(picture.depth.data, flat_picture.depth.data);

  rasterizer->forward(paged.view(), camera, scene.state, options, picture);
  flat_rasterizer->forward(flat.view(), camera, scene.state, options, flat_picture);
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
  flat_adam.resize(GetParam(), flat.count);
  ours.clear_statistics(paged.view());
  rasterizer->backward_step(gradient, rates, adam, paged.memory.data(), ours);
  flat_adam.step(flat.view(), flat.parameters.data(), theirs, rates, 2);
  float furthest = 0;
  paged.for_each([&](std::uint32_t i, std::size_t k) {
    for (int c = 0; c < channels; ++c) {
      const float before = scene.at(c, paged.source[k]);
      const float stepped = *paged.view().at(c, i);
      ASSERT_NEAR(stepped, flat.at(c, k), 1e-4F) << c;
      furthest = std::max(furthest, std::abs(stepped - before));
    }
  });
  EXPECT_NEAR(furthest, 0.01F, 1e-4F);
}

TEST_P(PagesTest, PagesOutsideOfTheFrustumAreLeftOutAndThePictureIsTheSame) {
  TestScene scene = testing::random_scene(GetParam(), 9000, {.spread = 6, .scale_low = 0.01F, .scale_high = 0.1F}, 8);
  PagedScene paged(scene, 12);
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
  PagedScene paged(scene, 1000);
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

/// A Gaussian whose page the test leaves out shows in no pixel, wherever it is and however large.
TEST(PageFrustum, IsExactForSingleGaussians) {
  TestScene scene = testing::random_scene(
      testing::radiance_layout(0), 4000,
      {.spread = 5, .scale_low = 0.001F, .scale_high = 1.0F, .logit_low = 5, .logit_high = 9, .objects = false}, 11);
  const auto rasterizer = make_cpu_rasterizer(1);
  Camera camera = testing::test_camera(48, 32);
  camera.near_m = 0.2F;
  std::size_t left_out = 0, invisible = 0;
  for (std::size_t i = 0; i < scene.count; ++i) {
    TestScene one(scene.layout, 1);
    one.state = scene.state;
    for (int c = 0; c < scene.layout.channels(); ++c) one.at(c, 0) = scene.at(c, i);
    Render picture;
    rasterizer->render(one.view(), camera, one.state, {}, picture);
    const bool shows = std::any_of(picture.alpha.data.begin(), picture.alpha.data.end(), [](float a) { return a > 0; });
    GaussiansView view = one.view();
    const std::vector<IndexRange> range{{0, 1}};
    const std::vector<PageBounds> bounds{bounds_of(view, range.front())};
    view.ranges = range;
    view.bounds = bounds;
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
    const bool selected = !select_ranges(view, pinhole, camera.world_from_camera, {}).empty();
    ASSERT_TRUE(selected || !shows) << i;
    left_out += selected ? 0 : 1;
    invisible += shows ? 0 : 1;
  }
  // It is not so careful that it leaves nothing out.
  EXPECT_GT(left_out, invisible / 2);
}

}  // namespace
}  // namespace splatbus::raster
