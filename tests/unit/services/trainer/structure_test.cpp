// What becomes of Gaussians between the optimizer's steps: pruned, densified, moved.
#include <algorithm>
#include <limits>

#include "cpu_optimizer_fixture.h"

namespace splatbus::trainer {
namespace {

TEST_F(CpuOptimizerTest, PrunesWhatIsTransparentHugeOrNotFinite) {
  Trial s = trial({{"prune_interval", "5"}, {"prune_min_age", "5"}});
  const HostModel before = s.model();
  s.poke(ParameterLayout::kOpacityLogit, 3, -9.0F);
  s.poke(ParameterLayout::kLogScale, 4, 3.0F);
  s.poke(20, 5, std::numeric_limits<float>::quiet_NaN());
  s.train(5);
  auto expected = before.ids();
  expected.erase(expected.begin() + 3, expected.begin() + 6);
  EXPECT_EQ(s.model().ids(), expected);
  s.train(5);
}

TEST_F(CpuOptimizerTest, SparesYoungGaussians) {
  Trial s = trial({{"prune_interval", "5"}, {"prune_min_age", "50"}});
  const std::size_t before = s.store().count();
  for (std::size_t k = 0; k < 30; ++k) s.poke(ParameterLayout::kOpacityLogit, k, -9.0F);
  s.train(5);
  EXPECT_EQ(s.store().count(), before);
  s.train(45);
  EXPECT_LE(s.store().count(), before - 25);
}

/// The average of a new Gaussian follows a jump of its value at once, that of an old one slowly: so it tells whose age
/// is kept where.
TEST_F(CpuOptimizerTest, AgeStaysWithAGaussianThatMoves) {
  const Settings settings = {{"prune", "false"},  {"lr_mean", "0"},   {"lr_log_scale", "0"}, {"lr_rotation", "0"},
                             {"lr_opacity", "0"}, {"lr_albedo", "0"}, {"lr_residual", "0"},  {"ema_decay", "0.999"}};
  Trial s = trial(settings);
  s.train(120);
  const HostModel before = s.model();
  // Over a page's room: all 300 move to new pages, among the new ones.
  s.insert(sample_batch(1, 2, 1500, 5));
  const HostModel after = s.model();
  std::size_t moved = 0;
  for (std::size_t k = 0; k < 300; ++k) moved += before.index(k) != after.index(k) ? 1 : 0;
  ASSERT_GT(moved, 200U);
  for (std::size_t k = 0; k < after.count(); ++k) *s.store().memory().value(0, after.index(k)) += 1;
  s.store().refresh_bounds();
  s.train(8);
  const HostModel now = s.model();
  for (std::size_t k = 0; k < now.count(); ++k) {
    const float share = now.average().plane(0)[k] - after.average().plane(0)[k];
    if (k < 300) {
      ASSERT_NEAR(share, 32.0F / 125, 0.01F) << k;  // 121 to 128 steps old
    } else {
      ASSERT_NEAR(share, 1, 1e-3F) << k;
    }
  }
}

TEST_F(CpuOptimizerTest, MomentsStayWithAGaussianThatMoves) {
  Trial moved = trial({{"prune", "false"}});
  Trial stayed = trial({{"prune", "false"}});
  const auto unseen = [](std::uint64_t batch, std::size_t count) {
    SampleBatch rows = sample_batch(1, batch, count, 5);
    std::fill(rows.opacity_logit.begin(), rows.opacity_logit.end(), -12.0F);
    return rows;
  };
  moved.train(10);
  const HostModel before = moved.model();
  moved.insert(unseen(2, 100));
  ASSERT_EQ(moved.model().index(0), before.index(0)) << "the page has room for them";
  moved.train(20);
  moved.insert(unseen(3, 1500));
  ASSERT_NE(moved.model().index(0), before.index(0));
  moved.train(3);
  stayed.train(33);
  const HostModel a = moved.model();
  const HostModel b = stayed.model();
  for (int c = 0; c < ParameterLayout::kResidual; ++c) {
    for (std::size_t k = 0; k < b.count(); ++k) ASSERT_NEAR(a.at(c, k), b.at(c, k), 1e-5F) << c << ", " << k;
  }
}

TEST_F(CpuOptimizerTest, APlaceThatWasSomebodyElsesBeginsAnew) {
  const Settings settings = {{"prune_interval", "5"}, {"prune_min_age", "5"}, {"prune_opacity", "0"}};
  Trial used = trial(settings);
  SampleBatch elsewhere = sample_batch(1, 3, 20);  // in the next page, so that the first one's indices stay
  elsewhere.object_id.assign(20, 7);
  elsewhere.opacity_logit.assign(20, -12.0F);
  used.insert(elsewhere);
  for (std::size_t k = 0; k < 300; ++k) used.poke(ParameterLayout::kLogScale, k, 3.0F);
  used.train(5);  // all are seen, and pruned
  ASSERT_EQ(used.store().count(), 20U);
  SampleBatch again = scene_.perturbed();
  again.batch = 2;
  used.insert(again);
  ASSERT_EQ(used.model().index(20) / kPageLanes, 0U);
  Trial never(connect("never"), Device::Cpu, scene_, settings);
  for (int i = 0; i < 4; ++i) {
    const TrainingView& view = *scene_.views()[static_cast<std::size_t>(i)];
    used.step({&view});
    never.step({&view});
  }
  const HostModel a = used.model();
  const HostModel b = never.model();
  ASSERT_EQ(a.count(), b.count() + 20);
  for (int c = 0; c < ParameterLayout::kResidual; ++c) {
    for (std::size_t k = 0; k < b.count(); ++k) ASSERT_NEAR(a.at(c, 20 + k), b.at(c, k), 1e-5F) << c << ", " << k;
  }
}

TEST_F(CpuOptimizerTest, DensifiesAllThatWasSeenWhereAnyGradientIsEnough) {
  Trial s = trial({{"densify", "true"}, {"densify_interval", "10"}, {"densify_gradient", "0"}, {"prune", "false"}});
  const std::size_t before = s.store().count();
  constexpr std::size_t kHidden = 40;
  for (std::size_t k = 0; k < kHidden; ++k) s.poke(ParameterLayout::kMean, k, 1e4F);
  s.train(9);
  EXPECT_EQ(s.store().count(), before);
  s.train(1);
  EXPECT_EQ(s.store().count(), 2 * before - kHidden);
  EXPECT_EQ(s.model().listed(), s.store().count());
  EXPECT_EQ(s.model().count(), s.store().count());
}

TEST_F(CpuOptimizerTest, APruningLeavesTheOthersWhatTheyGathered) {
  Trial s = trial({{"densify", "true"},
                   {"densify_interval", "6"},
                   {"densify_gradient", "0"},
                   {"densify_scale", "1000"},  // clones only
                   {"prune_interval", "5"},
                   {"prune_min_age", "5"}});
  const HostModel before = s.model();
  const std::uint32_t end = s.store().view().count;
  std::size_t last = 0, first = 0;  // by place in the page
  for (std::size_t k = 0; k < before.count(); ++k) {
    if (before.index(k) + 1 == end) last = k;
    if (before.index(k) == 3) first = k;
  }
  s.poke(ParameterLayout::kLogScale, first, 3.0F);  // seen, and pruned
  s.poke(ParameterLayout::kMean, last, 1e4F);       // never seen, and moved to its place
  s.train(5);
  ASSERT_EQ(s.store().count(), before.count() - 1);
  s.train(1);
  const HostModel after = s.model();
  EXPECT_EQ(after.count(), 2 * (before.count() - 1) - 1) << "all but one were cloned";
  const float* const x = after.live().plane(ParameterLayout::kMean);
  EXPECT_EQ(std::count(x, x + after.count(), 1e4F), 1);
}

TEST_F(CpuOptimizerTest, WhatAGaussianGatheredMovesAlongWhereAPruningMovesIt) {
  Trial s = trial({{"densify", "true"},
                   {"densify_interval", "6"},
                   {"densify_gradient", "1e-9"},
                   {"densify_scale", "1000"},  // clones only
                   {"prune_interval", "5"},
                   {"prune_min_age", "5"},
                   {"lr_opacity", "0"}});
  const HostModel before = s.model();
  const std::uint32_t end = s.store().view().count;
  std::size_t last = 0, first = 0;  // by place in the page
  for (std::size_t k = 0; k < before.count(); ++k) {
    if (before.index(k) + 1 == end) last = k;
    if (before.index(k) == 3) first = k;
  }
  constexpr float kMarked = 1.25F;
  s.poke(ParameterLayout::kOpacityLogit, first, -9.0F);   // in no picture, and pruned
  s.poke(ParameterLayout::kOpacityLogit, last, kMarked);  // in pictures, and moved to its place
  for (int c = 0; c < 3; ++c) s.poke(ParameterLayout::kMean + c, last, c == 1 ? 0.4F : 0.0F);
  s.train(5);
  ASSERT_EQ(s.store().count(), before.count() - 1);
  TrainingView away = *scene_.views()[0];
  away.camera.world_from_camera.translation.y += 100;
  s.step({&away});
  s.optimizer().finish();
  const HostModel after = s.model();
  EXPECT_GT(after.count(), before.count() + 100) << "others were cloned";
  const float* const logit = after.live().plane(ParameterLayout::kOpacityLogit);
  EXPECT_EQ(std::count(logit, logit + after.count(), kMarked), 2) << "and so was the one that had moved";
}

TEST_F(CpuOptimizerTest, OriginalsThatMoveAwayAreSplitAllTheSame) {
  scene_ = SyntheticScene(1500, 2, 48);
  Trial s = trial({{"densify", "true"},
                   {"densify_interval", "1"},
                   {"densify_gradient", "0"},
                   {"densify_scale", "1e-6"},
                   {"prune", "false"},
                   {"lr_log_scale", "0"}});
  const HostModel before = s.model();
  s.train(1);
  const HostModel after = s.model();
  std::size_t split = 0, moved = 0;
  for (std::size_t k = 0; k < before.count(); ++k) moved += before.index(k) != after.index(k) ? 1 : 0;
  ASSERT_GT(moved, 600U) << "their pages had no room for the copies";
  for (std::size_t k = 0; k < after.count(); ++k) {
    const float y = after.at(ParameterLayout::kLogScale + 1, k);
    if (k >= before.count()) {
      // A copy's original has become smaller too, and has been one of the scene's: about log 0.03.
      ASSERT_NEAR(y, std::log(0.03F / 1.6F), 0.21F) << k;
      continue;
    }
    const float smaller = before.at(ParameterLayout::kLogScale + 1, k) - y;
    if (smaller == 0) continue;
    ASSERT_NEAR(smaller, std::log(1.6F), 1e-5F) << k;
    ++split;
  }
  EXPECT_GT(split, 600U);
  EXPECT_EQ(after.count(), before.count() + split);
}

TEST_F(CpuOptimizerTest, AHandfulIsNotWorthAChangeOfStructure) {
  scene_ = SyntheticScene(1100, 1, 32);
  Trial s = trial({{"prune_interval", "5"}, {"prune_min_age", "5"}});
  s.poke(ParameterLayout::kLogScale, 3, 3.0F);
  s.poke(ParameterLayout::kLogScale, 4, 3.0F);
  s.train(5);
  EXPECT_EQ(s.store().count(), 1100U);
  s.poke(ParameterLayout::kLogScale, 5, 3.0F);
  s.train(5);
  EXPECT_EQ(s.store().count(), 1097U);
}

}  // namespace
}  // namespace splatbus::trainer
