// The optimizer on the CPU: what it finds again.
#include <sys/resource.h>

#include <algorithm>

#include "cpu_optimizer_fixture.h"

namespace splatbus::trainer {
namespace {

TEST_F(CpuOptimizerTest, FindsASceneAgain) {
  Trial s = trial();
  const double before = psnr(s);
  const double loss_before = s.train(6);
  s.train(228);
  EXPECT_LT(s.train(6), 0.3 * loss_before);
  EXPECT_GT(psnr(s), before + 8);
  EXPECT_GT(average_psnr(s), before + 8);
  EXPECT_EQ(s.store().step(), 240U);
  EXPECT_EQ(s.store().views(), 240U);
  const HostModel model = s.model();
  for (int c = ParameterLayout::kAlbedo; c < ParameterLayout::kResidual; ++c) {
    for (std::size_t k = 0; k < model.count(); ++k) {
      EXPECT_GE(model.at(c, k), 0.0F);
      EXPECT_LE(model.at(c, k), 1.0F);
    }
  }
}

TEST_F(CpuOptimizerTest, TheAverageIsGoodAfterTwentySteps) {
  Trial s = trial();
  const double before = average_psnr(s);
  s.train(20);
  EXPECT_GT(average_psnr(s), before + 1);
  EXPECT_GT(average_psnr(s), psnr(s) - 2);
}

TEST_F(CpuOptimizerTest, TrainsInBatchesWithDepthAndWithoutResidual) {
  Trial s = trial({{"batch", "3"}, {"depth_weight", "0.5"}, {"residual", "false"}});
  const double before = psnr(s);
  s.train(80);
  EXPECT_GT(psnr(s), before + 13);  // 15 dB when all terms are right
  EXPECT_EQ(s.store().views(), 240U);
  const HostModel model = s.model();
  for (int c = ParameterLayout::kResidual; c < model.live().layout.channels(); ++c) {
    for (std::size_t k = 0; k < model.count(); ++k) ASSERT_EQ(model.at(c, k), 0.0F);
  }
}

TEST_F(CpuOptimizerTest, DepthLossHasTheSlopeOfItsFiniteDifferences) {
  scene_ = SyntheticScene(40, 1);
  Trial s = trial({{"lr_mean", "0"},
                   {"lr_log_scale", "0"},
                   {"lr_rotation", "0"},
                   {"lr_albedo", "0"},
                   {"lr_residual", "0"},
                   {"albedo_weight", "0"},
                   {"lr_opacity", "1e-3"},
                   {"depth_weight", "100"},  // the picture's loss is nothing beside it
                   {"prune", "false"}});
  TrainingView view = *scene_.views().front();
  std::vector<float> depth(view.depth.data(), view.depth.data() + view.depth.size());
  for (float& metres : depth) metres *= 1.2F;  // surfaces lie behind the Gaussians, which should give way
  view.depth = Pixels<float>(std::move(depth));
  constexpr int kLogit = ParameterLayout::kOpacityLogit;
  const HostModel before = s.model();
  s.step({&view});
  const HostModel after = s.model();
  s.set("lr_opacity", "0");
  for (std::size_t k = 0; k < before.count(); ++k) s.poke(kLogit, k, before.at(kLogit, k));
  constexpr float kStep = 0.05F;
  std::size_t steep = 0;
  for (std::size_t k = 0; k < before.count(); ++k) {
    const auto loss_at = [&](float logit) {
      s.poke(kLogit, k, logit);
      const double loss = s.step({&view}).loss;
      s.poke(kLogit, k, before.at(kLogit, k));
      return loss;
    };
    const double slope = (loss_at(before.at(kLogit, k) + kStep) - loss_at(before.at(kLogit, k) - kStep)) / (2 * kStep);
    if (std::abs(slope) < 1e-3) continue;
    ++steep;
    EXPECT_EQ(after.at(kLogit, k) < before.at(kLogit, k), slope > 0)
        << "Adam's first step goes down the slope " << slope << " of " << k;
  }
  EXPECT_GT(steep, before.count() / 2);
}

TEST_F(CpuOptimizerTest, MaskedPixelsTeachNothing) {
  masked_pixels_teach_nothing(Device::Cpu, 1e-30);
}

TEST_F(CpuOptimizerTest, AfterAChangeLossFallsAsFastAsWithAFreshModel) {
  constexpr int kSteps = 150;
  const double fresh = loss_of_a_fresh_model(Device::Cpu, kSteps);
  const double with = loss_after_repainting(Device::Cpu, "true", kSteps);
  const double without = loss_after_repainting(Device::Cpu, "false", kSteps);
  EXPECT_LT(with, 1.15 * fresh);
  EXPECT_GT(without, 1.5 * fresh);
}

TEST_F(CpuOptimizerTest, TrainsRadiance) {
  Trial s = trial({{"appearance", "radiance"}, {"sh_degree", "1"}});
  const double loss_before = s.train(6);
  s.train(228);
  EXPECT_LT(s.train(6), 0.5 * loss_before);
}

TEST_F(CpuOptimizerTest, IsTheSameEveryTime) {
  Trial one = trial();
  Trial other = trial();
  one.train(20);
  other.train(20);
  expect_close(one, other, 1e-30);
}

TEST_F(CpuOptimizerTest, RepeatedBatchesChangeNothing) {
  Trial s = trial();
  const auto generation = s.store().generation();
  EXPECT_FALSE(s.insert(scene_.perturbed()));
  EXPECT_EQ(s.store().generation(), generation);
  EXPECT_TRUE(s.insert(sample_batch(1, 2, 10)));
  s.train(1);
}

TEST_F(CpuOptimizerTest, ABatchThatThereIsNoMemoryForLeavesTheModelToTheNextTrainer) {
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  GTEST_SKIP() << "a sanitizer ends the process where it gets no memory";
#endif
  Commands commands;
  commands.inserts.push_back(sample_batch(1, 2, 1500).on(Device::Cpu));
  commands.inserts.push_back(sample_batch(1, 3, 10).on(Device::Cpu));
  commands.inserts.back().count = std::size_t{1} << 30;  // nobody has memory to sort as many
  {
    Trial s(connect("trainer"), Device::Cpu, scene_, {}, std::size_t{1} << 23);
    ::rlimit limit{};
    ASSERT_EQ(::getrlimit(RLIMIT_AS, &limit), 0);
    const ::rlimit none{.rlim_cur = 0, .rlim_max = limit.rlim_max};
    s.train(1);
    ASSERT_EQ(::setrlimit(RLIMIT_AS, &none), 0);
    EXPECT_THROW(s.optimizer().apply(commands), std::exception);
    ASSERT_EQ(::setrlimit(RLIMIT_AS, &limit), 0);
  }
  Trial next(connect("trainer"), Device::Cpu, scene_, {});
  EXPECT_EQ(next.model().listed(), next.store().count());
  EXPECT_TRUE(next.store().count() == 300 || next.store().count() == 1800) << next.store().count();
  EXPECT_LT(next.train(3), 1.0);
  const std::size_t before = next.store().count();
  EXPECT_TRUE(next.insert(sample_batch(1, 4, 700)));
  next.train(3);
  EXPECT_EQ(next.store().count(), before + 700);
}

TEST_F(CpuOptimizerTest, TrainsWithEachLightsOwnVisibility) {
  expect_rows_of_lights(Device::Cpu);
}

TEST_F(CpuOptimizerTest, AnEmptyModelOrBatchIsNoStep) {
  Trial s = trial();
  EXPECT_EQ(s.optimizer().step({}).steps, 0U);
  EXPECT_EQ(s.store().step(), 0U);
}

TEST_F(CpuOptimizerTest, BoundsHoldAfterEveryStep) {
  Trial s = trial({{"lr_mean", "0.01"}});
  for (int i = 0; i < 20; ++i) {
    s.train(1);
    const GaussiansView view = s.store().view();
    for (std::size_t r = 0; r < view.ranges.size(); ++r) {
      const PageBounds exact = bounds_of(view, view.ranges[r]), &held = view.bounds[r];
      EXPECT_TRUE(held.low.x <= exact.low.x && held.low.y <= exact.low.y && held.low.z <= exact.low.z) << i;
      EXPECT_TRUE(held.high.x >= exact.high.x && held.high.y >= exact.high.y && held.high.z >= exact.high.z) << i;
      EXPECT_GE(held.max_scale_m, exact.max_scale_m) << i;
      // Adam's rate here is 5 cm a step: what is held for eight steps is within as many of the truth, on either side.
      EXPECT_LT(exact.low.x - held.low.x, 2 * 8 * 3.2F * 0.05F);
    }
  }
}

}  // namespace
}  // namespace splatbus::trainer
