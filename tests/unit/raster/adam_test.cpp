#include "raster/adam.h"

#include <gtest/gtest.h>

#include "scenes.h"

namespace splatbus::raster {
namespace {

using testing::TestScene;

struct Fixture {
  TestScene scene = testing::random_scene(testing::radiance_layout(0), 40, {}, 1);
  std::vector<float> before = scene.parameters;
  std::vector<float> rates = std::vector<float>(14, 0.1F);
  ParameterGradient gradient;
  Adam adam;

  Fixture() {
    gradient.clear(scene.view());
    std::fill(gradient.values.begin(), gradient.values.end(), 2.0F);
    std::fill(gradient.touched.begin(), gradient.touched.end(), std::uint8_t{1});
    adam.resize(scene.layout, scene.count);
  }
  void step() { adam.step(scene.view(), scene.parameters.data(), gradient, rates, 1); }
  /// How far a value has moved, in learning rates.
  float moved(int channel, std::size_t i) {
    return (before[static_cast<std::size_t>(channel) * scene.stride + i] - scene.at(channel, i)) / 0.1F;
  }
};

TEST(Adam, FirstStepIsOneLearningRate) {
  Fixture fixture;
  fixture.step();
  for (int c = 0; c < 14; ++c) {
    for (std::size_t i = 0; i < 40; ++i) ASSERT_NEAR(fixture.moved(c, i), 1, 1e-4F);
  }
}

TEST(Adam, RatesFallWithAGaussiansOwnSteps) {
  // The gradient is always the same, so that every step is as long as the rate.
  Fixture fixture;
  fixture.adam.lr_half_life_steps = 2;
  fixture.adam.lr_min_factor = 0.05F;
  fixture.step();
  EXPECT_NEAR(fixture.moved(3, 7), 2.0F / 3, 1e-3F);
  fixture.gradient.touched[8] = 0;
  fixture.step();
  EXPECT_NEAR(fixture.moved(3, 7), 2.0F / 3 + 2.0F / 4, 1e-3F);
  EXPECT_NEAR(fixture.moved(3, 8), 2.0F / 3, 1e-3F);
  fixture.gradient.touched[8] = 1;
  fixture.step();
  EXPECT_NEAR(fixture.moved(3, 8), 2.0F / 3 + 2.0F / 4, 1e-3F);  // what matters is its own
  for (int k = 0; k < 200; ++k) fixture.step();
  const float before = fixture.moved(3, 7);
  fixture.step();
  EXPECT_NEAR(fixture.moved(3, 7) - before, 0.05F, 1e-3F);
}

TEST(Adam, UntouchedAndFrozenRest) {
  Fixture fixture;
  fixture.gradient.touched[5] = 0;
  fixture.scene.flags[6] = kFrozen;
  fixture.step();
  EXPECT_EQ(fixture.moved(3, 5), 0);
  EXPECT_EQ(fixture.moved(3, 6), 0);
  EXPECT_NE(fixture.moved(3, 7), 0);
  // A first touch later is a first step, however many steps the others have taken.
  fixture.gradient.touched[5] = 1;
  fixture.step();
  EXPECT_NEAR(fixture.moved(3, 5), 1, 1e-4F);
}

TEST(Adam, ActiveChannelsOnly) {
  Fixture fixture;
  fixture.gradient.active_channels = 11;
  fixture.step();
  EXPECT_NE(fixture.moved(10, 0), 0);
  EXPECT_EQ(fixture.moved(11, 0), 0);
}

TEST(Adam, MomentsFollowMovesAndGrowth) {
  Fixture fixture, reference;
  fixture.step();
  reference.step();
  // Reverse the columns, then let the model grow into a larger stride.
  TestScene larger(fixture.scene.layout, 60);
  std::vector<std::uint32_t> all, aside, reversed;
  for (std::uint32_t i = 0; i < 40; ++i) {
    all.push_back(i);
    aside.push_back(40 + i);
    reversed.push_back(39 - i);
  }
  for (int c = 0; c < 14; ++c) {
    for (std::size_t i = 0; i < 40; ++i) larger.at(c, i) = fixture.scene.at(c, 39 - i);
  }
  fixture.adam.resize(larger.layout, 80);
  fixture.adam.move(all, aside);
  fixture.adam.move(aside, reversed);
  fixture.adam.resize(larger.layout, 40);
  fixture.adam.resize(larger.layout, 60);
  ParameterGradient gradient;
  gradient.clear(larger.view());
  std::fill(gradient.touched.begin(), gradient.touched.end(), std::uint8_t{1});
  std::fill(gradient.values.begin(), gradient.values.end(), 0.5F);
  fixture.adam.step(larger.view(), larger.parameters.data(), gradient, fixture.rates, 2);
  std::fill(reference.gradient.values.begin(), reference.gradient.values.end(), 0.5F);
  reference.step();
  for (int c = 0; c < 14; ++c) {
    for (std::size_t i = 0; i < 40; ++i) ASSERT_EQ(larger.at(c, i), reference.scene.at(c, 39 - i));
    for (std::size_t i = 40; i < 60; ++i) ASSERT_NEAR(larger.at(c, i), -0.1F, 1e-5F);
  }
}

TEST(Adam, ShrinkingForgets) {
  Fixture fixture;
  fixture.step();
  fixture.adam.resize(fixture.scene.layout, 10);
  fixture.adam.resize(fixture.scene.layout, 40);
  fixture.before = fixture.scene.parameters;
  std::fill(fixture.gradient.values.begin(), fixture.gradient.values.end(), -1.0F);
  fixture.step();
  EXPECT_NEAR(fixture.moved(0, 20), -1, 1e-4F);  // a first step
  EXPECT_GT(fixture.moved(0, 5), -0.5F);         // the momentum of the first step holds it back
}

TEST(Adam, FusedStepIsBackwardThenStep) {
  for (const ParameterLayout& layout : {testing::transfer_layout(), testing::radiance_layout(3)}) {
    for (const int active_channels : {0, 14}) {
      TestScene separate = testing::random_scene(layout, 1500, {.scale_high = 0.1F}, 9);
      for (std::size_t i = 0; i < separate.count; i += 5) separate.flags[i] = kFrozen;
      TestScene fused = separate;
      const Camera camera = testing::test_camera(40, 40);
      const std::vector<float> rates(static_cast<std::size_t>(layout.channels()), 0.01F);
      Adam separate_adam, fused_adam;
      separate_adam.resize(layout, separate.count);
      fused_adam.resize(layout, separate.count);
      const auto rasterizer = make_cpu_rasterizer(2);
      ParameterGradient gradient, statistics;
      gradient.active_channels = statistics.active_channels = active_channels;
      for (int step = 0; step < 3; ++step) {
        Render render;
        RenderGradient render_gradient;
        rasterizer->forward(separate.view(), camera, separate.state, {}, render);
        render_gradient.color = render.color;
        gradient.clear(separate.view());
        rasterizer->backward(render_gradient, gradient);
        separate_adam.step(separate.view(), separate.parameters.data(), gradient, rates, 2);

        rasterizer->forward(fused.view(), camera, fused.state, {}, render);
        render_gradient.color = render.color;
        statistics.clear_statistics(fused.view());
        rasterizer->backward_step(render_gradient, rates, fused_adam, fused.parameters.data(), statistics);
        EXPECT_EQ(statistics.touched, gradient.touched);
        EXPECT_EQ(statistics.mean2d_norm, gradient.mean2d_norm);
        EXPECT_EQ(statistics.contribution, gradient.contribution);
      }
      EXPECT_EQ(fused.parameters, separate.parameters);
    }
  }
}

}  // namespace
}  // namespace splatbus::raster
