// Which pages rest.
#include "trainer/freezing.h"

#include <algorithm>
#include <cmath>

#include "../../model/device_test.h"
#include "optimizer_fixture.h"

namespace splatbus::trainer {
namespace {

using model::PageState;

/// A store of some pages, of which a test says what views show of them.
class FreezerTest : public OptimizerTest {
 private:
  Trial make_trial() {
    scene_ = SyntheticScene(3000, 4, 32);
    return OptimizerTest::trial(Device::Cpu, {}, 8192);
  }

 protected:
  FreezerTest() : trial_(make_trial()) {
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
    Freezer::Change change = freezer_.decide(store(), options_, movements_);
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
  FreezeOptions options_{.after_s = 3, .least_gain = 0.05F, .most_movement = 0.02F, .unseen_s = 12, .thaw_rise = 1.5F};
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

TEST_F(FreezerTest, WhatHasAlmostNoLossMayHaveSeveralTimesThat) {
  for (int s = 0; s < 6; ++s) (void)second({0.0005});
  ASSERT_EQ(state(0), PageState::Frozen);
  EXPECT_TRUE(second({0.004}).thaw.empty()) << "no grey level more";
  EXPECT_EQ(second({0.006}).thaw, std::vector{pages_[0]});
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

TEST_F(FreezerTest, WhatIsSeenFromAfarAloneRestsAsItIs) {
  for (int s = 0; s < 3; ++s) (void)second({0.1, 0.2}, 8, 3);
  for (int s = 0; s < 11; ++s) EXPECT_TRUE(second({-1, 0.1}, 8, 7).freeze.empty()) << s;
  for (int s = 0; s < 4; ++s) (void)second({-1, 0.1}, 8, 7);
  EXPECT_EQ(state(1), PageState::Frozen);
  // What its loss is from there says nothing of how well it is known.
  EXPECT_TRUE(second({-1, 0.12}, 8, 7).thaw.empty());
  turn_sun(90);
  EXPECT_TRUE(second({-1, 0.12}, 8, 7).thaw.empty()) << "nor what it had settled under";
  EXPECT_EQ(second({-1, 0.1}, 8, 3).thaw, std::vector{pages_[1]});
}

TEST_F(FreezerTest, WhatLooksWorseFromAfarIsLearnedFromThere) {
  for (int s = 0; s < 6; ++s) (void)second({0.1, 0.1}, 8, 3);
  ASSERT_EQ(state(1), PageState::Frozen);
  for (int s = 0; s < 6; ++s) EXPECT_TRUE(second({0.1, 0.3}, 8, 8).thaw.empty()) << s;
  EXPECT_TRUE(second({0.1, 0.5}, 8, 8).thaw.empty()) << "something passed before it";
  for (int s = 0; s < 3; ++s) EXPECT_TRUE(second({0.1, 0.3}, 8, 8).thaw.empty()) << s;
  (void)second({0.1, 0.5}, 8, 8);
  EXPECT_EQ(second({0.1, 0.5}, 8, 8).thaw, std::vector{pages_[1]});
  // Those views count now: it settles again with what they come to.
  for (int s = 0; s < 9; ++s) (void)second({0.1, 0.4}, 8, 8);
  EXPECT_EQ(state(1), PageState::Frozen);
  EXPECT_FLOAT_EQ(store().table().entry(pages_[1]).loss, 0.4F);
}

TEST_F(FreezerTest, WhatGetsWorseIsLearnedFromWhereItIsSeenNow) {
  for (int s = 0; s < 6; ++s) (void)second({0.1, 0.1}, 8, 3);
  ASSERT_EQ(state(1), PageState::Frozen);
  for (int s = 0; s < 6; ++s) (void)second({0.1, 0.2}, 8, 8.0F + 8 * static_cast<float>(s));
  for (int s = 0; s < 2; ++s) (void)second({0.1, 0.5}, 8, 48);
  ASSERT_EQ(state(1), PageState::Active);
  // For longer than what nobody sees from near trains.
  for (int s = 0; s < 30; ++s) (void)second({0.1, 0.5 * std::pow(0.95, s)}, 8, 48);
  EXPECT_EQ(state(1), PageState::Active);
}

TEST_F(FreezerTest, AnotherLightIsLearnedFromAfarToo) {
  turn_sun(0);
  for (int s = 0; s < 6; ++s) (void)second({0.1, 0.1}, 8, 3);
  ASSERT_EQ(state(1), PageState::Frozen);
  EXPECT_TRUE(second({-1, 0.1}, 8, 8).thaw.empty());
  turn_sun(90);
  EXPECT_EQ(second({-1, 0.1}, 8, 8).thaw, std::vector{pages_[1]});
}

TEST_F(FreezerTest, WhatIsSeenFromNearerHasTwoWindowsToLearn) {
  for (int s = 0; s < 6; ++s) (void)second({0.1}, 8, 3);
  ASSERT_EQ(second({0.2}, 8, 1.9F).thaw, std::vector{pages_[0]});
  for (int s = 0; s < 5; ++s) (void)second({0.2}, 8, 1.9F);
  EXPECT_EQ(state(0), PageState::Active);
  for (int s = 0; s < 3; ++s) (void)second({0.2}, 8, 1.9F);
  EXPECT_EQ(state(0), PageState::Frozen);
}

TEST_F(FreezerTest, WhatLosesAGaussianNowAndThenRestsUnseenAllTheSame) {
  for (int s = 0; s < 3; ++s) (void)second({0.1, 0.2}, 8, 3);
  const std::size_t index = std::size_t{pages_[1]} * kPageLanes;
  for (int s = 0; s < 15; ++s) {
    std::vector<std::uint8_t> dead(store().view().count, 0);
    dead[index] = 1;
    store().remove(dead.data());
    (void)second({-1, 0.1}, 8, 7);
  }
  EXPECT_EQ(state(1), PageState::Frozen);
}

TEST_F(FreezerTest, WhoWalksAwaySeesNothingWorse) {
  for (int s = 0; s < 6; ++s) (void)second({0.1}, 8, 3);
  double loss = 0.1;
  for (int s = 0; s < 40; ++s) EXPECT_TRUE(second({loss *= 1.05}, 8, 6.5F + static_cast<float>(s)).thaw.empty()) << s;
}

TEST_F(FreezerTest, WhatLearnsNothingNewRestsAfterOneWindow) {
  for (int s = 0; s < 6; ++s) (void)second({0.1, 0.1});
  ASSERT_EQ(second({0.2, 0.2}).thaw.size(), 2U);
  double falling = 0.2;
  for (int s = 0; s < 5; ++s) (void)second({0.199, falling *= 0.9});
  EXPECT_EQ(state(0), PageState::Frozen);
  EXPECT_EQ(state(1), PageState::Active);
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

TEST_F(FreezerTest, AFlashIsNoOtherLight) {
  turn_sun(0);
  for (int s = 0; s < 6; ++s) (void)second({0.1});
  ASSERT_EQ(state(0), PageState::Frozen);
  EXPECT_TRUE(second({0.1}, 5).thaw.empty()) << "too few looks as yet";
  turn_sun(90);
  EXPECT_TRUE(second({0.1}, 3).thaw.empty()) << "three of eight";
  turn_sun(0);
  EXPECT_TRUE(second({0.1}, 4).thaw.empty());
  turn_sun(90);
  EXPECT_EQ(second({0.1}, 4).thaw, std::vector{pages_[0]}) << "half of them";
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

}  // namespace
}  // namespace splatbus::trainer
