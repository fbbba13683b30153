// Training with a loss on depth, and the statistics for clone and split, against the CPU backend and its Adam.
#include "cuda_scenes.h"
#include "raster/adam.h"
#include "raster/cuda/device_model.h"
#include "raster/cuda/train_step.h"
#include "raster/loss.h"

namespace splatbus::raster::testing {
namespace {

constexpr float kDepthWeight = 0.3F, kAlbedoWeight = 0.5F;
constexpr std::size_t kViews = 3, kSteps = 3;

/// Views of one size; the first has neither albedo nor depth.
struct Scene {
  Case c;
  SceneState state = random_scene(true);
  std::vector<Camera> cameras;
  std::vector<std::vector<std::uint8_t>> colors;
  std::vector<std::vector<float>> depths;

  explicit Scene(const Case& of) : c(of) {
    std::mt19937 random(17);
    std::uniform_real_distribution<float> metres(2.0F, 8.0F);
    const std::size_t pixels = std::size_t{c.width} * c.height;
    for (std::size_t k = 0; k < kViews; ++k) {
      const float angle = 2.0F * static_cast<float>(k);
      cameras.push_back(look_at({5 * std::cos(angle), 1.5F, 5 * std::sin(angle)}, {0, 0, 0}, c.width, c.height, 1.0F));
      colors.emplace_back(4 * pixels);
      for (auto& value : colors.back()) value = static_cast<std::uint8_t>(random() % 256);
      depths.emplace_back(pixels);
      for (float& value : depths.back()) value = random() % 4 == 0 ? 0.0F : metres(random);
      depths.back()[5] = INFINITY;  // no surface either
    }
  }
  [[nodiscard]] bool transfer() const { return c.layout.appearance == Appearance::Transfer; }
};

struct Trained {
  std::vector<float> parameters, mean2d_norm, steps;
  double loss = 0;             // of the last step
  std::uint32_t segments = 0;  // of patches' lists, behind their first
};

Trained train_on_cpu(const Scene& scene, GaussiansBuffer model, const std::vector<float>& rates) {
  const auto cpu = make_cpu_rasterizer(2);
  const std::size_t pixels = std::size_t{scene.c.width} * scene.c.height, count = model.count();
  Trained out{.mean2d_norm = std::vector<float>(count), .steps = std::vector<float>(count)};
  Adam adam;
  adam.resize(scene.c.layout, count);
  const LossOptions options{.encode_srgb = scene.transfer()};
  for (std::size_t step = 0; step < kSteps; ++step) {
    ParameterGradient gradient;
    gradient.clear(model.view());
    out.loss = 0;
    for (std::size_t k = 0; k < kViews; ++k) {
      const bool with_albedo = scene.transfer() && k > 0, with_depth = k > 0;
      Render render;
      cpu->forward(model.view(), scene.cameras[k], scene.state, {.albedo = with_albedo, .depth = with_depth}, render);
      RenderGradient g;
      out.loss += image_loss(render.color, scene.colors[k].data(), options, g.color) / kViews;
      for (float& value : g.color.data) value /= kViews;
      if (with_albedo) {
        out.loss += kAlbedoWeight * image_loss(render.albedo, scene.colors[k].data(), options, g.albedo) / kViews;
        for (float& value : g.albedo.data) value *= kAlbedoWeight / kViews;
      }
      if (with_depth) {
        g.depth = g.alpha = Image(scene.c.width, scene.c.height, 1);
        const float weight = kDepthWeight / static_cast<float>(kViews * pixels);
        for (std::size_t i = 0; i < pixels; ++i) {
          const float expected = scene.depths[k][i];
          if (expected == 0 || std::isinf(expected)) continue;
          const float difference = render.depth.data[i] - render.alpha.data[i] * expected;
          out.loss += double{weight} * std::abs(difference);
          g.depth.data[i] = std::copysign(weight, difference);
          g.alpha.data[i] = -g.depth.data[i] * expected;
        }
      }
      cpu->backward(g, gradient);
    }
    adam.step(model.view(), model.parameters.data(), gradient, rates, 2);
    for (std::size_t i = 0; i < count; ++i) {
      out.mean2d_norm[i] += gradient.mean2d_norm[i];
      out.steps[i] += gradient.touched[i] != 0 && (model.flags[i] & kFrozen) == 0 ? 1.0F : 0.0F;
    }
  }
  for (std::size_t c = 0; c < rates.size(); ++c) {
    const auto plane = model.parameters.begin() + static_cast<std::ptrdiff_t>(c * model.stride());
    out.parameters.insert(out.parameters.end(), plane, plane + static_cast<std::ptrdiff_t>(count));
  }
  return out;
}

class OnDevice {
 public:
  OnDevice(const Scene& scene, const GaussiansBuffer& model, const std::vector<float>& rates,
           const cuda::TrainStepOptions& options)
      : scene_(scene), train_(options) {
    device_.upload(model.view(), nullptr);
    for (std::size_t k = 0; k < kViews; ++k) {
      colors_[k].upload(scene.colors[k].data(), scene.colors[k].size(), nullptr);
      depths_[k].upload(scene.depths[k].data(), scene.depths[k].size(), nullptr);
    }
    cudaDeviceSynchronize();
    train_.set_model(device_.view());
    train_.set_learning_rates(rates);
  }

  [[nodiscard]] std::vector<cuda::TrainView> views(bool depth) const {
    std::vector<cuda::TrainView> out;
    for (std::size_t k = 0; k < kViews; ++k) {
      out.push_back({.view = {scene_.cameras[k], &scene_.state},
                     .color = colors_[k].data(),
                     .albedo = k > 0 ? colors_[k].data() : nullptr,
                     .depth = depth && k > 0 ? depths_[k].data() : nullptr});
    }
    return out;
  }
  [[nodiscard]] cuda::TrainStep& train() { return train_; }
  [[nodiscard]] const cuda::DeviceGaussians& gaussians() const { return device_.view(); }

  [[nodiscard]] Trained result() {
    const auto count = static_cast<std::size_t>(device_.view().count);
    Trained out{.parameters = std::vector<float>(count * static_cast<std::size_t>(scene_.c.layout.channels())),
                .mean2d_norm = std::vector<float>(count)};
    for (const float loss : train_.losses()) out.loss += double{loss};
    device_.download_parameters(out.parameters.data(), train_.stream());
    cudaMemcpyAsync(&out.segments, &train_.workspace().counts->segments, sizeof(out.segments), cudaMemcpyDefault,
                    train_.stream());
    const cuda::ScreenStatistics statistics = train_.statistics();
    if (statistics.steps != nullptr) {
      std::vector<std::uint32_t> steps(count);
      cudaMemcpyAsync(steps.data(), statistics.steps, count * sizeof(float), cudaMemcpyDefault, train_.stream());
      cudaMemcpyAsync(out.mean2d_norm.data(), statistics.mean2d_norm, count * sizeof(float), cudaMemcpyDefault,
                      train_.stream());
      cudaStreamSynchronize(train_.stream());
      out.steps.assign(steps.begin(), steps.end());
    }
    cudaStreamSynchronize(train_.stream());
    return out;
  }

 private:
  const Scene& scene_;
  cuda::DeviceModel device_;
  std::array<device::Buffer<std::uint8_t>, kViews> colors_;
  std::array<device::Buffer<float>, kViews> depths_;
  cuda::TrainStep train_;
};

constexpr Case kTransfer{"Transfer", {Appearance::Transfer, 0}, 600, 48, 40, true, true, -2.5F};
constexpr Case kRadiance{"Radiance", {Appearance::Radiance, 1}, 600, 48, 40, true, true, -2.5F};
constexpr Case kFaint{"Faint", {Appearance::Radiance, 0}, 2500, 24, 20, true, true, -1.5F, -4.0F};

class DepthTraining : public CudaTest, public ::testing::WithParamInterface<Case> {};

TEST_P(DepthTraining, FollowsTheCpuOptimizer) {
  const Scene scene(GetParam());
  const GaussiansBuffer model = random_model(scene.c, 3);
  const std::vector<float> rates(static_cast<std::size_t>(scene.c.layout.channels()), 1e-3F);
  const Trained expected = train_on_cpu(scene, model, rates);
  OnDevice on_device(scene, model, rates,
                     {.albedo_weight = kAlbedoWeight, .depth_weight = kDepthWeight, .statistics = true});
  for (std::size_t k = 0; k < kSteps; ++k) on_device.train().step(on_device.views(true));
  const Trained actual = on_device.result();
  if (scene.c.opacity_logit < 0) {
    EXPECT_GT(actual.segments, 0U);
  }
  EXPECT_NEAR(actual.loss, expected.loss, 5e-4);
  EXPECT_LT(relative_error(actual.parameters, expected.parameters), 1e-3);
  EXPECT_LT(relative_error(actual.mean2d_norm, expected.mean2d_norm), 5e-3);
  EXPECT_LT(relative_error(actual.steps, expected.steps), 5e-2);  // a pixel on the edge of 1/255 may fall either way
}

INSTANTIATE_TEST_SUITE_P(Cases, DepthTraining, ::testing::Values(kTransfer, kRadiance, kFaint), case_name);

TEST_F(CudaTest, DepthAndStatisticsComeAndGo) {
  const Scene scene({"", {Appearance::Transfer, 0}, 200, 24, 20, true, false, -2.0F});
  const GaussiansBuffer model = random_model(scene.c, 3);
  const std::vector<float> rates(41, 1e-3F);
  const auto train = [&](bool detour) {
    cuda::TrainStepOptions options{.depth_weight = kDepthWeight};
    OnDevice on_device(scene, model, rates, options);
    cuda::TrainStep& step = on_device.train();
    const std::vector<cuda::TrainView> with = on_device.views(true), without = on_device.views(false);
    for (int k = 0; k < 2; ++k) step.step(with);
    if (detour) {  // which forward() alone takes: nothing is learned
      step.forward(without);
      options.depth_weight = 0;
      step.set_options(options);
      step.forward(with);
      options.depth_weight = kDepthWeight;
      options.statistics = true;
      step.set_options(options);
    }
    for (int k = 0; k < 2; ++k) step.step(with);
    return on_device.result();
  };
  const Trained expected = train(false), actual = train(true);
  EXPECT_LT(relative_error(actual.parameters, expected.parameters), 1e-4);
  EXPECT_TRUE(expected.steps.empty());
  ASSERT_FALSE(actual.steps.empty());
  EXPECT_EQ(*std::max_element(actual.steps.begin(), actual.steps.end()), 2.0F);
}

TEST_F(CudaTest, StatisticsFollowTheColumns) {
  const Scene scene(kRadiance);
  const GaussiansBuffer model = random_model(scene.c, 3);
  const auto channels = static_cast<std::size_t>(scene.c.layout.channels());
  OnDevice on_device(scene, model, std::vector<float>(channels, 0.0F), {.statistics = true});
  cuda::TrainStep& train = on_device.train();
  train.step(on_device.views(false));
  const Trained before = on_device.result();
  std::uint32_t last = 0;
  for (std::uint32_t i = 1; i < before.steps.size(); ++i) last = before.mean2d_norm[i] > 0 ? i : last;
  const std::uint32_t from_to[2] = {last, 0};
  device::Buffer<std::uint32_t> moves;
  moves.upload(from_to, 2, train.stream());
  train.follow_model(on_device.gaussians(),
                     {.ranges = {}, .fresh = {}, .from = moves.data(), .to = moves.data() + 1, .moves = 1});
  const Trained moved = on_device.result();
  EXPECT_EQ(moved.mean2d_norm[0], before.mean2d_norm[last]);
  EXPECT_EQ(moved.steps[0], before.steps[last]);
  train.clear_statistics();
  EXPECT_EQ(on_device.result().mean2d_norm[0], 0.0F);
}

}  // namespace
}  // namespace splatbus::raster::testing
