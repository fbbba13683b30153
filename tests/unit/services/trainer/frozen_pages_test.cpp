// What becomes of pages that rest, on either device.
#include <algorithm>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "../../model/device_test.h"
#include "optimizer_fixture.h"

namespace splatbus::trainer {
namespace {

/// On either device.
class FreezingOn : public OptimizerTest, public testing::WithParamInterface<Device> {
 protected:
  FreezingOn() { scene_ = SyntheticScene(3000, 4, 32); }
  void SetUp() override {
    if (!has_device(GetParam())) GTEST_SKIP() << "no CUDA device";
  }
  Trial trial(const Settings& settings) { return OptimizerTest::trial(GetParam(), settings, 8192); }
  /// On CUDA every fourth step looks at pages.
  [[nodiscard]] int looking(int steps) const { return GetParam() == Device::Cuda ? 4 * steps : steps; }
  static std::vector<std::uint32_t> all_pages(Trial& s) {
    std::vector<std::uint32_t> pages;
    for (const IndexRange& range : s.store().view().ranges) pages.push_back(range.first / kPageLanes);
    return pages;
  }
};

/// Freezes all that it has seen sixteen times.
const Settings kAtOnce{{"freeze", "true"},        {"freeze_after_s", "0"}, {"freeze_gain", "1"},
                       {"freeze_movement", "10"}, {"ema_decay", "0.5"},    {"prune", "false"}};

TEST_P(FreezingOn, FrozenPagesAreAsTheirAveragesWereAndStayThat) {
  Trial s = trial(kAtOnce);
  s.train(looking(40));
  ASSERT_EQ(s.store().frozen_pages(), s.store().page_count());
  const HostModel before = s.model();
  EXPECT_EQ(distance(before.live(), before.average(), 41), 0);
  const double loss = s.train(looking(12));
  const HostModel after = s.model();
  EXPECT_EQ(distance(after.live(), before.live(), 41), 0);
  EXPECT_EQ(distance(after.average(), before.live(), 41), 0);
  EXPECT_GT(loss, 0) << "and is still looked at";
}

TEST_P(FreezingOn, WhereThePicturesChangeTheyLearnThem) {
  Trial s = trial(kAtOnce);
  s.train(looking(40));
  ASSERT_EQ(s.store().frozen_pages(), s.store().page_count());
  for (const TrainingView& view : repainted()) s.put(view);
  const double first = s.train(4);
  s.set("freeze_movement", "0");  // and does not rest at once
  s.train(looking(80));
  EXPECT_LT(s.store().frozen_pages(), s.store().page_count());
  EXPECT_LT(s.train(8), 0.6 * first);
}

TEST_P(FreezingOn, WithoutItAllTrainsAgain) {
  Trial s = trial(kAtOnce);
  s.train(looking(40));
  const HostModel before = s.model();
  s.set("freeze", "false");
  EXPECT_EQ(s.store().frozen_pages(), 0U);
  s.train(4);
  EXPECT_GT(distance(s.model().live(), before.live(), 41), 0);
}

TEST_P(FreezingOn, WhatComesBackFrozenTrainsWhereNothingIsToRest) {
  for (const char* freeze : {"false", "true"}) {
    Trial s = trial({{"freeze", freeze}, {"freeze_after_s", "3600"}});
    s.optimizer().restructure([&] { s.store().freeze(all_pages(s)); });
    EXPECT_EQ(s.store().frozen_pages(), freeze[0] == 't' ? s.store().page_count() : 0U);
  }
}

TEST_P(FreezingOn, PagesThatRestAreNeitherPrunedNorSplit) {
  Settings settings = kAtOnce;
  settings.back() = {"prune", "true"};
  // Later than all rest, for what either does to a page begins its window anew.
  const std::string interval = std::to_string(looking(50));
  settings.insert(settings.end(), {{"prune_interval", interval},
                                   {"prune_min_age", "0"},
                                   {"densify", "true"},
                                   {"densify_interval", interval},
                                   {"densify_gradient", "0"},
                                   {"thaw_rise", "100"}});
  Trial s = trial(settings);
  s.train(looking(40));
  ASSERT_EQ(s.store().frozen_pages(), s.store().page_count());
  for (std::size_t k = 0; k < 100; ++k) {
    trainer::poke(s.store(), ParameterLayout::kOpacityLogit, s.model().index(k), -20);
  }
  s.train(looking(20));
  EXPECT_EQ(s.store().count(), 3000U);
}

TEST_P(FreezingOn, PagesThatTrainAgainGoOnAtTheirAgeAndThosePastThemDoNotNotice) {
  // Never by itself.
  const Settings settings{
      {"freeze", "true"}, {"freeze_after_s", "3600"}, {"prune", "false"}, {"lr_half_life_steps", "5"}};
  Trial s = trial(settings), cpu = OptimizerTest::trial(Device::Cpu, settings, 8192);
  for (Trial* one : {&s, &cpu}) {
    one->train(20);
    const std::vector<std::uint32_t> pages = all_pages(*one);
    ASSERT_GE(pages.size(), 4U);
    const std::vector<std::uint32_t> some(pages.begin(), pages.begin() + 2);
    one->optimizer().restructure([&] { one->store().freeze(some); });
    ASSERT_EQ(one->store().frozen_pages(), 2U);
    const HostModel before = one->model();
    one->train(10);
    const HostModel after = one->model();
    std::size_t moved = 0;
    for (std::size_t k = 0; k < after.count(); ++k) {
      const bool rests = after.index(k) / kPageLanes == some[0] || after.index(k) / kPageLanes == some[1];
      ASSERT_TRUE(!rests || after.at(0, k) == before.at(0, k));
      moved += after.at(0, k) != before.at(0, k) ? 1 : 0;
    }
    EXPECT_GT(moved, 300U);
    one->optimizer().restructure([&] { one->store().thaw(some); });
    one->train(6);
  }
  expect_close(s, cpu, 1e-2);
  // With rates of beginners they would have gone this far.
  Trial young = trial(settings);
  young.train(6);
  EXPECT_LT(distance(s.model().live(), cpu.model().live(), ParameterLayout::kResidual),
            0.2 * distance(young.model().live(), cpu.model().live(), ParameterLayout::kResidual));
}

TEST_P(FreezingOn, WhereNothingModelsYetWhatShowsNothingIsLearned) {
  // Half of the floor.
  SampleBatch half = scene_.truth();
  for (std::size_t i = 0; i < half.count; ++i) {
    if (half.mean[i] > 0) half.opacity_logit[i] = -20;
  }
  const auto masked_share = [&](Device device, const char* opacity) {
    Trial s(connect("half-" + std::to_string(++trials_)), device, half, {{"mask_opacity", opacity}, {"prune", "false"}},
            8192);
    StepReport report = s.step({scene_.views()[0].get()});
    report += s.optimizer().finish();
    return report.masked_share;
  };
  const double share = masked_share(GetParam(), "0.5");
  EXPECT_NEAR(share, masked_share(Device::Cpu, "0.5"), 0.005);
  EXPECT_GT(share, 0.05);
  EXPECT_EQ(masked_share(GetParam(), "0"), 0);
}

TEST_P(FreezingOn, WhatIsLargerThanItsDistanceAllowsBecomesSmaller) {
  Trial s = trial({{"most_size", "0.1"}, {"prune", "false"}, {"lr_log_scale", "0"}});
  s.train(4);
  trainer::poke(s.store(), ParameterLayout::kLogScale, s.model().index(7), std::log(5.0F));
  s.train(8);
  const HostModel model = s.model();
  EXPECT_LT(std::exp(model.at(ParameterLayout::kLogScale, 7)), 1) << "cameras stand a few metres off";
  EXPECT_LT(std::exp(model.average().plane(ParameterLayout::kLogScale)[7]), 1);
  Trial without = trial({{"most_size", "0"}, {"prune", "false"}, {"lr_log_scale", "0"}});
  without.train(4);
  trainer::poke(without.store(), ParameterLayout::kLogScale, without.model().index(7), std::log(5.0F));
  without.train(8);
  EXPECT_FLOAT_EQ(std::exp(without.model().at(ParameterLayout::kLogScale, 7)), 5);
}

/// In a house nothing is the sky's fault, whatever it shows through walls that are not there yet.
TEST_P(FreezingOn, WhereASurfaceShowsTheFarFieldLearnsNothing) {
  SampleBatch half = scene_.truth();
  const std::size_t near = half.count;
  for (std::size_t i = 0; i < near; ++i) {
    half.opacity_logit[i] = half.mean[i] > 0 ? -20.0F : 0.5F;
  }
  SampleBatch sky;
  sky.count = 400;
  for (const auto& [plane, channels] :
       {std::pair(&sky.mean, 3), std::pair(&sky.log_scale, 3), std::pair(&sky.rotation, 4),
        std::pair(&sky.opacity_logit, 1), std::pair(&sky.albedo, 3), std::pair(&sky.normal, 3),
        std::pair(&sky.visibility, 1)}) {
    plane->assign(static_cast<std::size_t>(channels) * sky.count, 0.0F);
  }
  sky.object_id.assign(sky.count, kFarFieldFrame);
  for (std::size_t i = 0; i < sky.count; ++i) {
    const float z = 2 * (static_cast<float>(i) + 0.5F) / 400 - 1, angle = 2.399963F * static_cast<float>(i);
    const glm::vec3 towards(std::sqrt(1 - z * z) * std::cos(angle), z, std::sqrt(1 - z * z) * std::sin(angle));
    for (std::size_t c = 0; c < 3; ++c) {
      sky.mean[c * 400 + i] = kFarFieldCentre[static_cast<int>(c)] + kFarFieldRadius * towards[static_cast<int>(c)];
      sky.log_scale[c * 400 + i] = std::log(0.15F * kFarFieldRadius);
      sky.normal[c * 400 + i] = c == 1 ? 1.0F : 0.0F;
      sky.albedo[c * 400 + i] = 0.2F;
    }
    sky.rotation[i] = 1;
    sky.opacity_logit[i] = 4;
  }
  sky.scene.objects[kFarFieldFrame] = far_field();
  sky.epoch = half.epoch;
  sky.batch = half.batch + 1;
  TrainingView view = *scene_.views()[0];
  view.scene.objects[kFarFieldFrame] = far_field();
  view.depth = Pixels<float>(std::vector<float>(std::size_t{view.camera.width} * view.camera.height, 3.0F));

  const auto after = [&](Device device, bool with_depth) {
    Trial s(connect("sky-" + std::to_string(++trials_)), device, half,
            {{"prune", "false"}, {"freeze", "false"}, {"carve", "false"}}, 8192);
    Commands commands;
    commands.inserts.push_back(sky.on(device));
    s.optimizer().apply(commands, {});
    TrainingView seen = view;
    if (!with_depth) seen.depth = {};
    StepReport report;
    for (int step = 0; step < 12; ++step) report += s.step({&seen});
    report += s.optimizer().finish();
    const HostModel model = s.model();
    float moved = 0;
    std::size_t of_sky = 0;
    for (std::size_t k = 0; k < model.count(); ++k) {
      if (model.live().object_id[k] != kFarFieldFrame) continue;
      ++of_sky;
      moved = std::max(moved, std::abs(model.at(ParameterLayout::kAlbedo, k) - 0.2F));
    }
    EXPECT_EQ(of_sky, sky.count);
    return std::pair(moved, report.masked_share);
  };
  const auto [moved, masked] = after(GetParam(), true);
  EXPECT_EQ(moved, 0);
  EXPECT_GT(masked, 0.05) << "though the far field makes all of it opaque";
  EXPECT_LT(masked, 0.9) << "half of it is modelled";
  EXPECT_NEAR(masked, after(Device::Cpu, true).second, 0.02);
  const auto [blamed, unmasked] = after(GetParam(), false);
  EXPECT_GT(blamed, 0.01F) << "where nobody knows what is a surface";
  EXPECT_EQ(unmasked, 0);
}

INSTANTIATE_TEST_SUITE_P(Devices, FreezingOn, testing::Values(Device::Cpu, Device::Cuda), model::device_name);

}  // namespace
}  // namespace splatbus::trainer
