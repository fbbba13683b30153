// Objects that begin to move, and that vanish, from the engine's pictures to the model.
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
  EXPECT_TRUE(until([&] { return gaussians_about(place, reach, kBall) > before * 2 / 3; }))
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

}  // namespace
}  // namespace splatbus::objects_test
