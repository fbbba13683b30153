// Which pages rest, and what becomes of them.
#include "trainer/freezing.h"

#include <algorithm>

#include "../../model/device_test.h"
#include "optimizer_fixture.h"

namespace splatbus::trainer {
namespace {

using model::PageState;

class FreezingTest : public OptimizerTest {
 protected:
  FreezingTest() { scene_ = SyntheticScene(3000, 4, 32); }
};

/// A store of some pages, of which a test says what views show of them.
class FreezerTest : public FreezingTest {
 protected:
  FreezerTest() : trial_(OptimizerTest::trial(Device::Cpu, {}, 8192)) {
    for (const IndexRange& range : store().view().ranges) pages_.push_back(range.first / kPageLanes);
    movements_.assign(pages_.size(), 0.0F);
  }
  model::PageStore& store() { return trial_.store(); }

  /// A second of optimizer time, in which `looks` views show these errors, page by page; below 0: not at all.
  Freezer::Change second(const std::vector<double>& errors, int looks = 8, float distance_m = 3) {
    ViewLook look{.view = nullptr, .loss = 0, .pages = {}};
    TrainingView view;
    view.scene = scene;
    view.camera.fx = 100;
    const PageBounds bounds = store().view().bounds[0];
    view.camera.world_from_camera.translation = {bounds.high.x + distance_m, bounds.low.y, bounds.low.z};
    look.view = std::make_shared<const TrainingView>(view);
    for (std::size_t p = 0; p < errors.size(); ++p) {
      if (errors[p] >= 0) look.pages.push_back({pages_[p], 5, errors[p]});
    }
    for (int k = 0; k < looks; ++k) freezer_.see(store(), std::span(&look, 1));
    store().add_time(1);
    EXPECT_TRUE(freezer_.due(store()));
    const Freezer::Change change = freezer_.decide(store(), options_, movements_);
    EXPECT_FALSE(freezer_.due(store()));
    store().freeze(change.freeze);
    store().thaw(change.thaw);
    return change;
  }
  [[nodiscard]] PageState state(std::size_t p) { return store().table().entry(pages_[p]).now.state; }

  /// From now on the sun stands there.
  void turn_sun(float to_deg) {
    scene.version += 1;
    scene.light.sun_irradiance = glm::vec3(2);
    scene.light.sun_direction = {std::cos(glm::radians(to_deg)), 0, std::sin(glm::radians(to_deg))};
  }

  SceneState scene;
  Trial trial_;
  FreezeOptions options_{.after_s = 3, .least_gain = 0.05F, .most_movement = 0.02F, .thaw_rise = 1.5F};
  Freezer freezer_;
  std::vector<std::uint32_t> pages_;
  std::vector<float> movements_;
};

TEST_F(FreezerTest, APageRestsOnceItsLossNoLongerFallsAndItIsStill) {
  ASSERT_GE(pages_.size(), 4U);
  movements_[2] = 0.03F;
  double falling = 0.2;
  for (int s = 1; s <= 6; ++s) {
    falling *= 0.97;
    const Freezer::Change change = second({0.1, falling, 0.1, s % 2 == 0 ? 0.1 : 0.11});
    EXPECT_TRUE(change.thaw.empty());
    EXPECT_EQ(change.freeze, s < 6 ? std::vector<std::uint32_t>{} : (std::vector{pages_[0], pages_[3]})) << s;
  }
  const model::PageEntry& entry = store().table().entry(pages_[0]);
  EXPECT_FLOAT_EQ(entry.loss, 0.1F);
  EXPECT_EQ(entry.contribution, 5);
  EXPECT_EQ(store().table().entry(pages_[2]).movement, 0.03F);
  movements_[2] = 0.01F;
  falling *= 0.6;  // it goes on
  for (int s = 7; s <= 9; ++s) (void)second({0.1, falling, 0.1, 0.1});
  EXPECT_EQ(state(1), PageState::Active);
  EXPECT_EQ(state(2), PageState::Frozen);
  for (int s = 10; s <= 12; ++s) (void)second({0.1, falling, 0.1, 0.1});
  EXPECT_EQ(state(1), PageState::Frozen);
}

TEST_F(FreezerTest, TooFewPicturesSayNothing) {
  for (int s = 0; s < 20; ++s) (void)second({0.1}, s < 10 ? 1 : 0);
  EXPECT_EQ(state(0), PageState::Active) << "twice eight looks came, the second time none of late";
}

TEST_F(FreezerTest, ItTrainsAgainWhereItsLossRises) {
  for (int s = 0; s < 6; ++s) (void)second({0.1, 0.1});
  ASSERT_EQ(state(0), PageState::Frozen);
  EXPECT_TRUE(second({0.145, 0.1}).thaw.empty());
  EXPECT_EQ(second({0.17, 0.1}).thaw, std::vector{pages_[0]});
  // And rests again when it has learned what there was.
  for (int s = 0; s < 8; ++s) (void)second({0.12, 0.1});
  EXPECT_EQ(state(0), PageState::Frozen);
}

TEST_F(FreezerTest, ItTrainsAgainWhenAViewComesNearer) {
  for (int s = 0; s < 6; ++s) (void)second({0.1}, 8, 3);
  ASSERT_EQ(state(0), PageState::Frozen);
  EXPECT_TRUE(second({0.1}, 8, 2.2F).thaw.empty());
  EXPECT_EQ(second({0.1}, 8, 1.9F).thaw, std::vector{pages_[0]});
  for (int s = 0; s < 8; ++s) (void)second({0.1}, 8, 1.9F);
  ASSERT_EQ(state(0), PageState::Frozen);
  for (int s = 0; s < 6; ++s) EXPECT_TRUE(second({0.1}, 8, s % 2 == 0 ? 6 : 1.9F).thaw.empty());
}

TEST_F(FreezerTest, WhatNoViewShowsRestsUntilOneDoes) {
  for (int s = 0; s < 12; ++s) (void)second({0.1});
  EXPECT_EQ(state(1), PageState::Active);
  for (int s = 0; s < 3; ++s) (void)second({0.1});
  EXPECT_EQ(state(1), PageState::Frozen);
  EXPECT_EQ(second({0.1, 0.1}).thaw, std::vector{pages_[1]}) << "it had not settled";
}

TEST_F(FreezerTest, WhatHadNotSettledDoesNotTrainFromAfar) {
  for (int s = 0; s < 3; ++s) (void)second({0.1, 0.1}, 8, 3);
  for (int s = 0; s < 13; ++s) (void)second({0.1});
  ASSERT_EQ(state(1), PageState::Frozen);
  for (int s = 0; s < 3; ++s) EXPECT_TRUE(second({0.1, 0.3}, 8, 7).thaw.empty());
  EXPECT_EQ(second({0.1, 0.3}, 8, 5).thaw, std::vector{pages_[1]});
}

TEST_F(FreezerTest, NobodyHasToComeAsNearAsACameraThatStoodInIt) {
  for (int s = 0; s < 3; ++s) (void)second({0.1, 0.1}, 8, 0.3F);
  for (int s = 0; s < 13; ++s) (void)second({0.1}, 8, 0.3F);
  ASSERT_EQ(state(1), PageState::Frozen);
  EXPECT_TRUE(second({-1, 0.3}, 8, 5).thaw.empty());
  EXPECT_EQ(second({-1, 0.3}, 8, 3.5F).thaw, std::vector{pages_[1]});
}

TEST_F(FreezerTest, WhatAFolderHadFrozenRestsAtWhatItIsFirstSeenWith) {
  for (int s = 0; s < 6; ++s) (void)second({0.1, 0.1});
  ASSERT_EQ(state(0), PageState::Frozen);
  // As restored: its loss did not come along, and the freezer is a new one.
  store().table().entry(pages_[0]).loss = -1;
  freezer_ = {};
  EXPECT_TRUE(second({0.2}).thaw.empty());
  EXPECT_FLOAT_EQ(store().table().entry(pages_[0]).loss, 0.2F);
  EXPECT_TRUE(second({0.25}).thaw.empty());
  EXPECT_EQ(second({0.4}).thaw, std::vector{pages_[0]});
}

TEST_F(FreezerTest, WhatAFolderHadFrozenTrainsWhenAViewComesNearerThanTheFirst) {
  for (int s = 0; s < 6; ++s) (void)second({0.1, 0.1});
  ASSERT_EQ(state(0), PageState::Frozen);
  store().table().entry(pages_[0]).loss = -1;
  freezer_ = {};
  EXPECT_TRUE(second({0.1}, 8, 12).thaw.empty());
  EXPECT_TRUE(second({0.1}, 8, 9).thaw.empty());
  EXPECT_EQ(second({0.1}, 8, 3).thaw, std::vector{pages_[0]});
}

TEST_F(FreezerTest, ItTrainsAgainUnderAnotherLight) {
  std::vector<double> seen(pages_.size(), 0.1);
  turn_sun(0);
  for (int s = 0; s < 6; ++s) (void)second(seen);
  ASSERT_EQ(store().frozen_pages(), pages_.size());
  turn_sun(4);
  EXPECT_TRUE(second(seen).thaw.empty());
  turn_sun(8);
  EXPECT_EQ(second({0.1}).thaw, std::vector{pages_[0]}) << "the others were not seen";
  for (int s = 0; s < 6; ++s) EXPECT_TRUE(second({0.1}).freeze.empty()) << s << ": it is to settle anew";
  EXPECT_EQ(second({0.1}).freeze, std::vector{pages_[0]});
}

TEST_F(FreezerTest, NothingRestsWhileTheLightTurns) {
  const std::vector<double> seen(pages_.size(), 0.1);
  for (int s = 0; s < 20; ++s) {
    turn_sun(15.0F * static_cast<float>(s));
    EXPECT_TRUE(second(seen).freeze.empty()) << s;
  }
}

TEST_F(FreezerTest, LightsThatComeBackAreKnown) {
  const std::vector<double> seen(pages_.size(), 0.1);
  const auto blink = [&](int s) {
    turn_sun(s % 2 == 0 ? 0.0F : 90.0F);
    return second(seen);
  };
  for (int s = 0; s < 12; ++s) (void)blink(s);
  EXPECT_EQ(store().frozen_pages(), pages_.size());
  for (int s = 0; s < 6; ++s) EXPECT_TRUE(blink(s).thaw.empty()) << s;
  turn_sun(45);
  EXPECT_EQ(second(seen).thaw.size(), pages_.size());
}

TEST_F(FreezerTest, WhatOldPicturesShowIsNotOfTheNewLight) {
  turn_sun(0);
  for (int s = 0; s < 6; ++s) (void)second({0.1, 0.1});
  ASSERT_EQ(state(1), PageState::Frozen);
  const SceneState before = scene;
  turn_sun(90);
  const SceneState now = scene;
  EXPECT_EQ(second({0.1}).thaw, std::vector{pages_[0]});
  scene = before;
  for (int s = 0; s < 6; ++s) EXPECT_TRUE(second({-1, 0.1}).thaw.empty()) << s;
  scene = now;
  EXPECT_EQ(second({-1, 0.1}).thaw, std::vector{pages_[1]});
}

TEST(LightChange, IsTheShareOfWhatArrivesThatIsAnother) {
  Light light;
  light.sun_irradiance = glm::vec3(2);
  light.sources = {{.id = 3, .position = {0, 1, 0}, .intensity = glm::vec3(2)}};
  EXPECT_EQ(light_change(light, light), 0);
  Light other = light;
  other.sun_direction = {1, 0, 0};
  EXPECT_NEAR(light_change(light, other), std::sqrt(2.0F) / 2, 1e-5F);
  other = light;
  other.sun_irradiance = {std::sqrt(12.0F), 0, 0};
  EXPECT_GT(light_change(light, other), 0.3F) << "as strong, of another colour";
  other = light;
  other.sources[0].position.x = 5;
  EXPECT_NEAR(light_change(light, other), 0.5F, 1e-5F);
  other.sources[0].position.x = 0.1F;
  EXPECT_NEAR(light_change(light, other), 0.05F, 1e-5F);
  other.sources.clear();
  EXPECT_NEAR(light_change(light, other), 0.5F, 1e-5F);
  EXPECT_NEAR(light_change(other, light), 0.5F, 1e-5F);
  other = light;
  other.sun_irradiance = glm::vec3(0);
  EXPECT_NEAR(light_change(light, other), 0.5F, 1e-5F);
  EXPECT_EQ(light_change({}, {}), 0) << "a night is as dark as another";
}

TEST_F(FreezerTest, WhatIsPutInIsToBeLearned) {
  for (int s = 0; s < 5; ++s) (void)second({0.1});
  SampleBatch more = scene_.truth();
  more.batch = 2;
  ASSERT_TRUE(trial_.insert(more));
  const auto ranges = store().view().ranges;
  pages_.clear();
  for (const IndexRange& range : ranges) pages_.push_back(range.first / kPageLanes);
  movements_.assign(pages_.size(), 0.0F);
  for (int s = 0; s < 6; ++s) EXPECT_TRUE(second({0.1}).freeze.empty()) << s;
  EXPECT_FALSE(second({0.1}).freeze.empty()) << "twice 3 s, and those before that began in the midst of some";
}

TEST(NearestPixels, AreThoseOfTheNearestPointOfThePage) {
  TrainingView view;
  view.camera.fx = 120;
  view.camera.world_from_camera.translation = {0, 0, 5};
  const PageBounds bounds{{-1, -1, -1}, {1, 1, 1}, 0.1F};
  EXPECT_FLOAT_EQ(nearest_px_per_m(view, kWorldFrame, bounds), 30);
  EXPECT_EQ(nearest_px_per_m(view, 7, bounds), 0) << "not in the scene";
  view.scene.objects[7] = Rigid{.translation = {0, 0, -5}};
  view.scene.objects[7].scale = 2;
  EXPECT_FLOAT_EQ(nearest_px_per_m(view, 7, bounds), 120 / 8.0F);
  view.camera.world_from_camera.translation = {0.5F, 0, 0};
  EXPECT_FLOAT_EQ(nearest_px_per_m(view, kWorldFrame, bounds), 480) << "within";
}

/// On either device.
class FreezingOn : public FreezingTest, public testing::WithParamInterface<Device> {
 protected:
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
