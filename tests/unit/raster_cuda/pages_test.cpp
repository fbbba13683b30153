// A model in pages is drawn and trained as the same Gaussians without pages; pages that no view sees are left out.
#include "../gaussians/paged_model.h"
#include "cuda_rasterizer.h"
#include "cuda_scenes.h"
#include "raster/cuda/train_step.h"

namespace splatbus::raster::testing {
namespace {

constexpr Case kPagedTransfer{"Transfer", {Appearance::Transfer, 0}, 4000, 70, 50, true, true, -2.5F};
constexpr Case kPagedRadiance{"Radiance", {Appearance::Radiance, 2}, 4000, 70, 50, true, true, -2.5F};

/// `spread`: how many times as far apart the Gaussians are.
GaussiansBuffer spread_model(const Case& c, float spread) {
  GaussiansBuffer model = random_model(c, 19);
  for (std::size_t k = 0; k < 3 * model.stride(); ++k) model.parameters[k] *= spread;
  return model;
}

std::uint32_t listed(const cuda::WorkspaceView& w) {
  std::uint32_t count = 0;
  cudaMemcpy(&count, &w.counts->listed, sizeof(count), cudaMemcpyDeviceToHost);
  return count;
}

class CudaPages : public CudaTest, public ::testing::WithParamInterface<Case> {};

TEST_P(CudaPages, PicturesAndGradientsAreThoseWithoutPages) {
  const Case& c = GetParam();
  const test::PagedModel paged(random_model(c, 19).view(), 700);
  ASSERT_GE(paged.ranges.size(), 6U);
  const SceneState scene = random_scene(true);
  const Camera camera = look_at({0.5F, 1.5F, 5.0F}, {0, 0, 0}, c.width, c.height, 1.0F);
  const RenderOptions options{.albedo = c.layout.appearance == Appearance::Transfer, .depth = true};
  const auto ours = make_cuda_rasterizer(), theirs = make_cuda_rasterizer();
  Render picture, expected;
  ours->forward(paged.view(), camera, scene, options, picture);
  theirs->forward(paged.planar.view(), camera, scene, options, expected);
  EXPECT_LT(largest_difference(picture.color, expected.color), 1e-5);
  EXPECT_LT(largest_difference(picture.albedo, expected.albedo), 1e-5);
  EXPECT_LT(largest_difference(picture.depth, expected.depth), 1e-4);

  std::mt19937 random(5);
  RenderGradient gradient;
  gradient.color = random_image(c.width, c.height, 3, random);
  ParameterGradient actual, without;
  actual.clear(paged.view());
  without.clear(paged.planar.view());
  ours->backward(gradient, actual);
  theirs->backward(gradient, without);
  double difference = 0, norm = 0;
  std::size_t touched = 0;
  paged.for_each([&](std::uint32_t i, std::size_t k) {
    touched += actual.touched[i];
    ASSERT_EQ(actual.touched[i], without.touched[k]);
    ASSERT_NEAR(actual.contribution[i], without.contribution[k], 1e-5F);
    ASSERT_NEAR(actual.mean2d_norm[i], without.mean2d_norm[k], 1e-3F * (1 + without.mean2d_norm[k]));
    for (std::size_t channel = 0; channel < paged.channels; ++channel) {
      const double value = without.values[channel * without.stride + k];
      difference += std::pow(actual.values[channel * actual.stride + i] - value, 2);
      norm += value * value;
    }
  });
  EXPECT_LT(std::sqrt(difference / norm), 1e-4);
  EXPECT_GT(touched, paged.planar.count() / 4);
}

TEST_P(CudaPages, FrozenPagesAreDrawnAndGetNoGradient) {
  const Case& c = GetParam();
  const test::PagedModel moving(random_model(c, 19).view(), 300);
  test::PagedModel paged = moving;
  for (std::size_t r = 0; r < paged.ranges.size(); r += 2) paged.ranges[r].frozen = 1;
  const SceneState scene = random_scene(true);
  const Camera camera = look_at({0.5F, 1.5F, 5.0F}, {0, 0, 0}, c.width, c.height, 1.0F);
  const auto ours = make_cuda_rasterizer(), theirs = make_cuda_rasterizer();
  Render picture, expected;
  ours->forward(paged.view(), camera, scene, {}, picture);
  theirs->forward(moving.view(), camera, scene, {}, expected);
  EXPECT_LT(largest_difference(picture.color, expected.color), 1e-5);
  std::mt19937 random(5);
  RenderGradient gradient;
  gradient.color = random_image(c.width, c.height, 3, random);
  ParameterGradient actual, without;
  actual.clear(paged.view());
  without.clear(moving.view());
  ours->backward(gradient, actual);
  theirs->backward(gradient, without);
  double difference = 0, norm = 0;
  for (const IndexRange& range : paged.ranges) {
    for (std::size_t channel = 0; channel < paged.channels; ++channel) {
      for (std::uint32_t i = range.first; i < range.first + range.count; ++i) {
        const double value = actual.values[channel * actual.stride + i];
        const double other = range.frozen != 0 ? 0.0 : without.values[channel * without.stride + i];
        ASSERT_TRUE(range.frozen == 0 || value == 0);
        difference += std::pow(value - other, 2);
        norm += other * other;
      }
    }
  }
  EXPECT_GT(norm, 0);
  EXPECT_LT(std::sqrt(difference / norm), 1e-4);
}

TEST_P(CudaPages, PagesOutsideOfTheFrustumAreLeftOutAndThePictureIsTheSame) {
  const Case& c = GetParam();
  const test::PagedModel paged(spread_model(c, 4).view(), 12);
  SceneState scene = random_scene(true);
  scene.objects.at(7).scale = 1.8F;
  cuda::DeviceModel all, bounded;
  all.upload(paged.view(), nullptr);
  bounded.upload(paged.bounded_view(), nullptr);
  cudaDeviceSynchronize();
  for (const float height : {0.4F, 3.0F}) {
    Camera camera = look_at({0.3F, height, 3.0F}, {0.05F, -0.1F, 0}, 80, 60, 0.5F);
    camera.cx += 9;
    cuda::ForwardPass pass;
    Render expected, picture;
    pass.draw(all.view(), camera, scene, {}, false);
    pass.download(expected);
    EXPECT_EQ(listed(pass.workspace()), paged.ranges.size());
    pass.draw(bounded.view(), camera, scene, {}, false);
    pass.download(picture);
    EXPECT_EQ(largest_difference(picture.color, expected.color), 0);
    EXPECT_GT(*std::max_element(picture.alpha.data.begin(), picture.alpha.data.end()), 0.5F);

    // The host lists the same ones, but for rounding.
    const cuda::SceneView view{camera, &scene};
    const cuda::DeviceView device = cuda::make_view_tables({&view, 1}, c.layout.appearance).views[0];
    const FrustumCamera pinhole{camera.fx,
                                camera.fy,
                                camera.cx,
                                camera.cy,
                                80,
                                60,
                                camera.near_m,
                                0.3F,
                                std::max(-device.limit_x_low, device.limit_x_high),
                                std::max(-device.limit_y_low, device.limit_y_high)};
    const auto chosen = select_ranges(paged.bounded_view(), pinhole, camera.world_from_camera, scene.objects);
    EXPECT_LT(chosen.size(), paged.ranges.size() * 9 / 10);
    EXPECT_GT(chosen.size(), 5U);
    std::vector<cuda::ListedRange> list(listed(pass.workspace()));
    EXPECT_NEAR(static_cast<double>(list.size()), static_cast<double>(chosen.size()), 1);
    cudaMemcpy(list.data(), pass.workspace().listed, list.size() * sizeof(list[0]), cudaMemcpyDeviceToHost);
    EXPECT_TRUE(std::is_sorted(list.begin(), list.end(), [](auto& a, auto& b) { return a.first < b.first; }));
  }
}

/// What training has made of a model on the device.
struct TrainedOnDevice {
  cuda::DeviceModel model;
  cuda::TrainStep train{cuda::TrainStepOptions{}};
  device::Buffer<std::uint8_t> picture;
  std::vector<cuda::TrainView> views;

  TrainedOnDevice(const Case& c, const GaussiansView& gaussians, const SceneState& scene, int count = -1,
                  std::span<const IndexRange> ranges = {}) {
    model.upload(gaussians, nullptr);
    const std::vector<std::uint8_t> target(std::size_t{4} * c.width * c.height, 90);
    picture.upload(target.data(), target.size(), nullptr);
    cudaDeviceSynchronize();
    cuda::DeviceGaussians first = model.view();
    if (count >= 0) first.count = count;
    train.set_model(first, ranges);
    train.set_learning_rates(std::vector<float>(static_cast<std::size_t>(c.layout.channels()), 0.02F));
    // Two cameras that look past one another, so that most pages show in one of them at most.
    for (const float side : {-1.0F, 1.0F}) {
      const Camera camera = look_at({0, 1, 3}, {3 * side, 0, -3}, c.width, c.height, 0.6F);
      views.push_back({.view = {camera, &scene}, .color = picture.data()});
    }
  }
  void steps(int count) {
    for (int k = 0; k < count; ++k) train.step(views);
    EXPECT_EQ(train.finished(true).steps, static_cast<std::size_t>(count));
  }
  std::vector<float> parameters() {
    std::vector<float> out(static_cast<std::size_t>(model.view().layout.channels() * model.view().count));
    model.download_parameters(out.data(), train.stream());
    cudaStreamSynchronize(train.stream());
    return out;
  }
};

TEST_P(CudaPages, StepsAreThoseWithoutPagesAndBoundsHoldAfterThem) {
  const Case& c = GetParam();
  const test::PagedModel paged(spread_model(c, 3).view(), 25);
  const SceneState scene = random_scene(true);
  TrainedOnDevice ours(c, paged.bounded_view(), scene), theirs(c, paged.planar.view(), scene);
  ours.steps(3);
  theirs.steps(3);
  const std::vector<float> trained = ours.parameters(), expected = theirs.parameters();
  const GaussiansView view = paged.view_of(trained.data(), paged.channels * kPageLanes);
  double difference = 0, moved = 0;
  paged.for_each([&](std::uint32_t i, std::size_t k) {
    for (std::size_t channel = 0; channel < paged.channels; ++channel) {
      const double value = expected[channel * paged.planar.count() + k];
      difference += std::pow(*view.at(static_cast<int>(channel), i) - value, 2);
      moved += std::pow(value - paged.planar.parameters[channel * paged.planar.stride() + k], 2);
    }
  });
  ASSERT_GT(moved, 0);
  // Of Gaussians that hardly matter, the sign of the gradient is rounding.
  EXPECT_LT(std::sqrt(difference / moved), 0.1);

  std::vector<PageBounds> bounds(paged.ranges.size());
  cudaMemcpy(bounds.data(), ours.model.view().bounds, bounds.size() * sizeof(bounds[0]), cudaMemcpyDeviceToHost);
  std::size_t changed = 0;
  for (std::size_t k = 0; k < bounds.size(); ++k) {
    const PageBounds truth = bounds_of(view, paged.ranges[k]);
    EXPECT_EQ(bounds[k].low.x, truth.low.x);
    EXPECT_EQ(bounds[k].low.y, truth.low.y);
    EXPECT_EQ(bounds[k].low.z, truth.low.z);
    EXPECT_EQ(bounds[k].high.x, truth.high.x);
    EXPECT_EQ(bounds[k].high.y, truth.high.y);
    EXPECT_EQ(bounds[k].high.z, truth.high.z);
    EXPECT_NEAR(bounds[k].max_scale_m, truth.max_scale_m, 1e-5F * truth.max_scale_m);
    changed += bounds[k].high.x != paged.bounds[k].high.x || bounds[k].low.x != paged.bounds[k].low.x ? 1 : 0;
  }
  EXPECT_GT(changed, 3U);
}

TEST_P(CudaPages, AnObjectThatTheSceneDoesNotHaveIsHidden) {
  const Case& c = GetParam();
  const test::PagedModel paged(random_model(c, 19).view(), 700);
  const SceneState scene = random_scene(false);
  const Camera camera = look_at({0.5F, 1.5F, 5.0F}, {0, 0, 0}, c.width, c.height, 1.0F);
  GaussiansBuffer transparent = paged.planar;
  for (std::size_t k = 0; k < transparent.count(); ++k) {
    if (transparent.object_id[k] != kWorldFrame) {
      transparent.parameters[ParameterLayout::kOpacityLogit * transparent.stride() + k] = -30;
    }
    transparent.object_id[k] = kWorldFrame;
  }
  Render expected, actual;
  make_cpu_rasterizer(2)->render(transparent.view(), camera, scene, {}, expected);
  for (const GaussiansView& view : {paged.planar.view(), paged.view(), paged.bounded_view()}) {
    make_cuda_rasterizer()->render(view, camera, scene, {}, actual);
    EXPECT_LT(largest_difference(actual.color, expected.color), 1e-3);
  }
}

TEST_P(CudaPages, AStepLeavesFrozenPagesAsTheyAreAndGivesThemNoMoments) {
  const Case& c = GetParam();
  test::PagedModel paged(random_model(c, 19).view(), 300);
  std::size_t training = 0;
  for (std::size_t r = 0; r < paged.ranges.size(); ++r) {
    paged.ranges[r].frozen = r % 3 != 0 ? 1 : 0;
    training += paged.ranges[r].frozen == 0 ? 1 : 0;
  }
  const SceneState scene = random_scene(true);
  TrainedOnDevice device(c, paged.bounded_view(), scene, -1, paged.ranges);
  EXPECT_EQ(device.train.moment_bytes(), training * (2 * paged.channels + 3) * kPageLanes * sizeof(float));
  const std::vector<float> before = device.parameters();
  device.steps(3);
  const std::vector<float> after = device.parameters();
  std::size_t moved = 0;
  for (const IndexRange& range : paged.ranges) {
    for (std::uint32_t i = range.first; i < range.first + range.count; ++i) {
      for (std::size_t channel = 0; channel < paged.channels; ++channel) {
        const std::size_t at = ((i >> kPageShift) * paged.channels + channel) * kPageLanes + i % kPageLanes;
        ASSERT_TRUE(range.frozen == 0 || before[at] == after[at]);
        moved += before[at] != after[at] ? 1 : 0;
      }
    }
  }
  EXPECT_GT(moved, 1000U);
}

TEST_P(CudaPages, MorePagesThanThereIsRoomForAreListedTheNextTime) {
  const Case& c = GetParam();
  const test::PagedModel paged(spread_model(c, 3).view(), 25);
  const SceneState scene = random_scene(true);
  TrainedOnDevice device(c, paged.bounded_view(), scene);
  // First from where little shows, then from where all does.
  const std::vector<cuda::TrainView> wide = device.views;
  const Camera away = look_at({0, 1, 3}, {0, 60, 40}, c.width, c.height, 0.2F);
  for (cuda::TrainView& view : device.views) view.view.camera = away;
  device.steps(80);  // long enough for what was there first to shrink
  const std::uint32_t few = device.train.workspace().list_capacity;
  const std::vector<float> before = device.parameters();
  device.views = wide;
  device.steps(1);
  EXPECT_GT(device.train.workspace().list_capacity, few);
  EXPECT_EQ(listed(device.train.workspace()), [&] {
    std::uint32_t seen = 0;
    cudaMemcpy(&seen, &device.train.workspace().counts->seen, sizeof(seen), cudaMemcpyDeviceToHost);
    return seen;
  }());
  const std::vector<float> after = device.parameters();
  std::size_t moved = 0;  // lanes that hold no Gaussian are not numbers
  for (std::size_t k = 0; k < before.size(); ++k) moved += before[k] < after[k] || before[k] > after[k] ? 1 : 0;
  EXPECT_GT(moved, 1000U) << "and the step was taken";
}

INSTANTIATE_TEST_SUITE_P(Cases, CudaPages, ::testing::Values(kPagedTransfer, kPagedRadiance), case_name);

TEST_F(CudaTest, MomentsStayWhenTheModelGrowsAndGoWhenTheyAreForgotten) {
  Case large = kPagedRadiance;
  large.count = 40'000;  // more than one piece of memory takes
  GaussiansBuffer model = random_model(large, 19);
  constexpr int kFirst = 3000;
  for (std::size_t i = kFirst; i < model.count(); ++i) model.parameters[2 * model.stride() + i] = 1000;
  const SceneState scene = random_scene(true);
  enum class Change { None, Growth, Forget, NewModel };
  const auto trained = [&](Change change) {
    TrainedOnDevice device(large, model.view(), scene, kFirst);
    device.steps(4);
    if (change == Change::Growth) device.train.follow_model(device.model.view());
    if (change == Change::Forget) {
      cuda::DeviceGaussians same = device.model.view();
      same.count = kFirst;
      std::vector<IndexRange> all;
      for (std::uint32_t i = 0; i < kFirst; i += kPageLanes) all.push_back({i, std::min(kPageLanes, kFirst - i)});
      device.train.follow_model(same, {.ranges = {}, .fresh = all});
    }
    if (change == Change::NewModel) {
      cuda::DeviceGaussians same = device.model.view();
      same.count = kFirst;
      device.train.set_model(same);
    }
    device.steps(4);
    return device.parameters();
  };
  const std::vector<float> kept = trained(Change::None), anew = trained(Change::NewModel);
  const double apart = relative_error(anew, kept);
  EXPECT_GT(apart, 0);
  EXPECT_LT(relative_error(trained(Change::Growth), kept), 0.3 * apart);
  EXPECT_LT(relative_error(trained(Change::Forget), anew), 0.3 * apart);
}

}  // namespace
}  // namespace splatbus::raster::testing
