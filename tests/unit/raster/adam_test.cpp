#include "raster/adam.h"

#include <gtest/gtest.h>

#include <cmath>

#include "raster/loss_history.h"
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

/// With means at the origin, looked at along z.
struct AgeFixture : Fixture {
  ObjectTransforms objects;

  AgeFixture() {
    adam.lr_half_life_steps = 10;
    adam.lr_min_factor = 0;
    rates[0] = rates[1] = rates[2] = 0;
    for (int c = 0; c < 3; ++c) {
      for (std::size_t i = 0; i < 40; ++i) scene.parameters[static_cast<std::size_t>(c) * scene.stride + i] = 0;
    }
  }
  void look_from(std::initializer_list<float> distances) {
    adam.views.clear();
    for (const float distance : distances) {
      AdamView& view = adam.views.emplace_back();
      view.camera.fx = 100;
      view.camera.world_from_camera.translation = {0, 0, -distance};
      view.objects = &objects;
    }
  }
  void steps(int count) {
    for (int k = 0; k < count; ++k) step();
  }
  /// Of the next step; the gradient is always the same.
  float rate() {
    const float moved_before = moved(3, 7);
    step();
    return moved(3, 7) - moved_before;
  }
  static float rate_at(float age) { return 10 / (10 + age); }
};

TEST(Adam, ADistantViewDoesNotAge) {
  AgeFixture fixture;
  fixture.look_from({1});
  fixture.steps(2);
  fixture.look_from({20});  // a pixel takes 400 times the area
  fixture.steps(400);
  EXPECT_NEAR(fixture.rate(), AgeFixture::rate_at(4 * (2 + 401.0F / 400)), 2e-3F);
  // One at less than twice the distance does, all of it.
  AgeFixture about;
  about.look_from({1});
  about.steps(1);
  about.look_from({1.9F});
  about.steps(100);
  EXPECT_NEAR(about.rate(), AgeFixture::rate_at(102), 2e-3F);
}

TEST(Adam, WhatDistantViewsTaughtIsLittleWhenOneComesNear) {
  AgeFixture fixture;
  fixture.look_from({20});
  fixture.steps(400);
  EXPECT_NEAR(fixture.rate(), AgeFixture::rate_at(401), 2e-3F);
  fixture.look_from({1});
  EXPECT_NEAR(fixture.rate(), AgeFixture::rate_at(4 * (401.0F / 400 + 1)), 2e-3F);
  // However slowly it came.
  AgeFixture slow;
  for (int k = 400; k > 0; --k) {
    slow.look_from({1 + 19 * static_cast<float>(k) / 400});
    slow.step();
  }
  slow.look_from({1});
  EXPECT_GT(slow.rate(), AgeFixture::rate_at(100));
}

TEST(Adam, TheNearestOfAStepsViewsCountsAndNoneThatLooksAway) {
  AgeFixture fixture;
  fixture.look_from({1});
  fixture.steps(1);
  fixture.look_from({20, 1, 20});
  fixture.steps(50);
  EXPECT_NEAR(fixture.rate(), AgeFixture::rate_at(52), 2e-3F);
  AgeFixture behind;
  behind.look_from({2});
  behind.steps(50);
  behind.look_from({2, -0.1F});  // it stands beyond them, and looks on
  EXPECT_NEAR(behind.rate(), AgeFixture::rate_at(51), 2e-3F);
}

TEST(Adam, DistanceIsThatOfTheObjectAsItStands) {
  AgeFixture fixture;
  const IndexRange page{.first = 0, .count = 40, .frame_id = 7};
  GaussiansView paged = fixture.scene.view();
  paged.page_shift = kPageShift;
  paged.ranges = std::span(&page, 1);
  const auto step = [&] {
    fixture.adam.step(paged, fixture.scene.parameters.data(), fixture.gradient, fixture.rates, 1);
  };
  const auto rate = [&] {
    const float before = fixture.moved(3, 7);
    step();
    return fixture.moved(3, 7) - before;
  };
  fixture.objects[7] = Rigid{.translation = {0, 0, -19}};
  fixture.look_from({20});
  step();
  fixture.objects[7] = ObjectTransform();
  for (int k = 0; k < 400; ++k) step();
  EXPECT_NEAR(rate(), AgeFixture::rate_at(4 * (1 + 401.0F / 400)), 2e-3F);
  // Twenty times as large it shows as much as near by.
  for (std::size_t i = 0; i < 40; ++i) fixture.scene.parameters[2 * fixture.scene.stride + i] = -0.95F;
  fixture.objects[7].scale = 20;
  for (int k = 0; k < 50; ++k) step();
  EXPECT_LT(rate(), AgeFixture::rate_at(52));
}

TEST(Adam, RatesRecoverWhereLossHasRisenAndGradientsAgree) {
  const auto rate_after = [](bool risen, bool agree) {
    AgeFixture fixture;
    auto& gradient = fixture.gradient.values;
    double mean = 0, square = 0;
    const auto step = [&](bool turn) {
      if (turn) {
        for (float& value : gradient) value = -value;
      }
      mean = 0.9 * mean + 0.1 * gradient[0];
      square = 0.999 * square + 0.001 * gradient[0] * gradient[0];
      fixture.step();
    };
    fixture.look_from({1});
    for (int k = 0; k < 400; ++k) step(true);
    fixture.adam.views[0].loss_has_risen = risen;
    for (int k = 0; k < 30; ++k) step(!agree);
    const float before = fixture.moved(11, 7);
    step(!agree);
    return (fixture.moved(11, 7) - before) / static_cast<float>(mean / std::sqrt(square / (1 - std::pow(0.999, 431))));
  };
  EXPECT_NEAR(rate_after(false, true), AgeFixture::rate_at(431), 2e-3F);
  EXPECT_NEAR(rate_after(true, false), AgeFixture::rate_at(431), 2e-3F) << "it is noise";
  EXPECT_GT(rate_after(true, true), AgeFixture::rate_at(9));
}

TEST(LossHistory, ALossHasRisenOverItsOwnCamerasSlowMean) {
  LossHistory history;
  Camera camera{.id = 3}, other{.id = 4}, input{.id = 3, .role = CameraRole::Input};
  for (int k = 0; k < 7; ++k) history.add(camera, 0.1F);
  EXPECT_EQ(history.limit(camera), INFINITY) << "not known yet";
  history.add(camera, 0.1F);
  EXPECT_NEAR(history.limit(camera), 0.12F, 1e-4F);
  EXPECT_EQ(history.limit(other), INFINITY);
  EXPECT_EQ(history.limit(input), INFINITY);
  for (int k = 0; k < 100; ++k) history.add(camera, 0.1F);
  history.add(camera, NAN);
  for (int k = 0; k < 10; ++k) history.add(camera, 0.2F);
  EXPECT_LT(history.limit(camera), 0.2F) << "it stays risen for a while";
  for (int k = 0; k < 100; ++k) history.add(camera, 0.2F);
  EXPECT_GT(history.limit(camera), 0.2F) << "and then that is how it is";
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
