// Objects that begin to move, and that vanish, from the engine's pictures to the model.
#include <algorithm>
#include <set>

#include "chain_fixture.h"

namespace splatbus::objects_test {
namespace {

constexpr std::uint32_t kBall = AnalyticScene::kBall;
constexpr int kBeatsIn2s = 4;
/// What stands within two pixels of a picture over a floor that it sees at a slant is not told from the floor.
constexpr std::size_t kHandful = 200;

TEST_F(ChainTest, AnObjectThatIsListedAndBeginsToMoveKeepsItsGaussians) {
  engine_.objects[kBall] = {};
  start();
  const glm::vec3 place = engine_.scene.ball_centre;
  const float reach = 1.2F * engine_.scene.ball_radius;
  const std::size_t before = gaussians_about(place, reach, kBall);
  ASSERT_GT(before, 100U);
  EXPECT_EQ(gaussians_about(place, reach, kWorldFrame), 0U);
  for (int k = 1; k <= kBeatsIn2s; ++k) {
    const glm::vec3 moved(0.25F * static_cast<float>(k), 0, 0.1F * static_cast<float>(k));
    engine_.objects[kBall] = Rigid{.translation = moved};
    engine_.scene.ball_centre = place + moved;
    beat();
  }
  // Inputs show it at its new place, from sides that were hidden.
  const std::uint64_t rounds = expander_->counters().rounds;
  ASSERT_TRUE(until([&] { return expander_->counters().rounds > rounds && settled(); }));
  EXPECT_EQ(gaussians_about(place, reach, kWorldFrame), 0U);
  EXPECT_GE(gaussians_about(place, reach, kBall), before * 9 / 10);
  EXPECT_LT(gaussians_about(place, reach, kBall), before * 13 / 10) << "inserted twice";
}

TEST_F(ChainTest, AnObjectThatIsListedOnlyAsItBeginsToMoveLeavesNoGhost) {
  start();
  const glm::vec3 place = engine_.scene.ball_centre;
  const float reach = 1.2F * engine_.scene.ball_radius;
  const std::size_t before = gaussians_about(place, reach, kWorldFrame);
  ASSERT_GT(before, 100U);
  for (int k = 1; k <= kBeatsIn2s; ++k) {
    const glm::vec3 moved(0.4F * static_cast<float>(k), 0, 0.2F * static_cast<float>(k));
    engine_.objects[kBall] = Rigid{.translation = moved};
    engine_.scene.ball_centre = place + moved;
    beat();
  }
  EXPECT_TRUE(until([&] { return gaussians_about(place, reach, kWorldFrame) <= before / kHandful; }))
      << gaussians_about(place, reach, kWorldFrame) << " of " << before;
  EXPECT_TRUE(until([&] { return gaussians_about(place, reach, kBall) > before / 2; }))
      << "it is itself again: " << gaussians_about(place, reach, kBall);
}

TEST_F(ChainTest, WhatVanishesUnlistedLeavesNoGhost) {
  start();
  const glm::vec3 place = engine_.scene.ball_centre;
  const float reach = 1.2F * engine_.scene.ball_radius;
  const std::size_t before = gaussians_about(place, reach, kWorldFrame);
  ASSERT_GT(before, 100U);
  engine_.scene.ball_centre.y = -100;
  for (int k = 1; k <= kBeatsIn2s; ++k) beat();
  EXPECT_TRUE(until([&] { return gaussians_about(place, reach, kWorldFrame) <= before / kHandful; }))
      << gaussians_about(place, reach, kWorldFrame) << " of " << before;
}

TEST_F(ChainTest, AnObjectThatGrowsKeepsItsGaussiansAndLeavesNoGhostAsItShrinks) {
  const glm::vec3 place = engine_.scene.ball_centre;
  const float radius = engine_.scene.ball_radius;
  const auto scale_to = [&](float scale) {
    engine_.objects[kBall] = Rigid{.translation = place};
    engine_.objects[kBall].scale = scale;
    engine_.scene.ball_radius = scale * radius;
  };
  scale_to(1);
  start();
  const std::size_t before = gaussians_about({}, 1.2F * radius, kBall);
  ASSERT_GT(before, 100U);
  for (const float scale : {1.2F, 1.4F, 0.6F}) {
    scale_to(scale);
    for (int k = 0; k < 2; ++k) beat();
    ASSERT_TRUE(until([&] { return settled(); }));
    EXPECT_GE(gaussians_about({}, 1.2F * radius, kBall), before * 9 / 10) << scale;
    EXPECT_LT(gaussians_about({}, 2 * radius, kBall), before * 13 / 10) << "inserted twice at " << scale;
    EXPECT_EQ(gaussians_about(place, 2 * radius, kWorldFrame), 0U) << scale;
  }
}

TEST_F(ChainTest, AnIdThatIsGivenToAnotherObjectShowsNothingOfTheFirst) {
  engine_.objects[kBall] = {};
  start();
  const glm::vec3 place = engine_.scene.ball_centre;
  const float radius = engine_.scene.ball_radius;
  const auto within = [&](float part) { return gaussians_about(place, part * radius, kBall); };
  const std::size_t before = within(1.2F);
  ASSERT_GT(before, 100U);
  EXPECT_EQ(within(0.7F), 0U);
  engine_.objects.erase(kBall);
  engine_.scene.ball_centre.y = -100;
  for (int k = 0; k < kBeatsIn2s; ++k) beat();
  // Another comes by that id: a ball of half the size where the first one's middle was.
  engine_.objects[kBall] = {};
  engine_.scene.ball_centre = place;
  engine_.scene.ball_radius = radius / 2;
  for (int k = 0; k < kBeatsIn2s; ++k) beat();
  EXPECT_TRUE(until([&] { return within(1.2F) - within(0.7F) <= before / kHandful; }))
      << within(1.2F) - within(0.7F) << " of " << before;
  // It takes a quarter of the pixels, of which the rounds that see it first need not have all.
  EXPECT_TRUE(until([&] { return within(0.7F) > before / 16; })) << within(0.7F) << " of " << before;
}

/// The floor in patches, each an object with an id of its own.
class PatchesTest : public ChainTest {
 protected:
  static constexpr int kSide = 32;

  /// All over the 32 bits, with both ends of what is no signed number.
  static std::uint32_t id_of(int patch) {
    if (patch == 0) return 0xFFFFFFFF;
    if (patch == 1) return 0x80000000;
    return static_cast<std::uint32_t>(patch) * 4194301U;
  }
  static glm::vec3 centre_of(int patch) {
    const float size_m = 2 * AnalyticScene::kFloorHalf / kSide;
    return {(static_cast<float>(patch % kSide) + 0.5F) * size_m - AnalyticScene::kFloorHalf, 0,
            (static_cast<float>(patch / kSide) + 0.5F) * size_m - AnalyticScene::kFloorHalf};
  }
  static int patch_at(const glm::vec4& position) {
    const auto row = [](float at) {
      return std::clamp(static_cast<int>((at / AnalyticScene::kFloorHalf + 1) * kSide / 2), 0, kSide - 1);
    };
    return row(position.z) * kSide + row(position.x);
  }

  PatchesTest() {
    set(bridge_parameters_, "input_size", "96");
    set(trainer_parameters_, "appearance", "radiance");  // a page of each object: small ones
    set(trainer_parameters_, "sh_degree", "0");
    engine_.relabel = [this](const capture_bridge::InputView& view) {
      for (std::size_t i = 0; i < view.pixels(); ++i) {
        if (view.object_id[i] != AnalyticScene::kFloor) continue;
        view.object_id[i] = id_of(patch_at(view.position[i] - glm::vec4(moved_m_, 0, 0, 0)));
      }
    };
    for (int patch = 0; patch < kSide * kSide; ++patch) {
      engine_.objects[id_of(patch)] = Rigid{.translation = centre_of(patch)};
    }
  }

  float moved_m_ = 0;  ///< along x, all of them
};

TEST_F(PatchesTest, ThousandsOfObjectsHaveFramesOfTheirOwnWhateverTheirIds) {
  start();
  std::set<std::uint32_t> modelled;
  const GaussiansView view = trainer_->store().view();
  const float reach = AnalyticScene::kFloorHalf / kSide + 0.02F;
  for (const IndexRange& range : view.ranges) {
    if (range.frame_id == kWorldFrame) continue;
    EXPECT_TRUE(engine_.objects.contains(range.frame_id)) << range.frame_id;
    if (range.count > 0) modelled.insert(range.frame_id);
    for (std::uint32_t i = range.first; i < range.first + range.count; ++i) {
      EXPECT_LT(std::abs(*view.at(ParameterLayout::kMean, i)), reach) << "in its own frame";
      EXPECT_LT(std::abs(*view.at(ParameterLayout::kMean + 2, i)), reach);
    }
  }
  EXPECT_TRUE(modelled.contains(0xFFFFFFFF));
  EXPECT_TRUE(modelled.contains(0x80000000));
  EXPECT_GT(modelled.size(), engine_.objects.size() * 9 / 10);
  EXPECT_LT(view.ranges.size(), modelled.size() + 64) << "a page each";
  // They move together, each in its own frame.
  moved_m_ = 0.06F;
  for (auto& [id, object] : engine_.objects) object.rigid.translation.x += moved_m_;
  const std::size_t count = trainer_->store().count();
  const std::uint64_t rounds = expander_->counters().rounds;
  beat();
  ASSERT_TRUE(until([&] { return expander_->counters().rounds > rounds && settled(); }));
  EXPECT_LT(trainer_->store().count(), count * 3 / 2) << "inserted twice";  // and strips along the patches' borders
}

}  // namespace
}  // namespace splatbus::objects_test
