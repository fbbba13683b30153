// Insertion in the frames of objects.
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <tuple>

#include "gaussians/light.h"
#include "insertion_fixture.h"

namespace splatbus::expander::test {
namespace {

TEST_P(InsertionTest, SamplesOfMovingObjectsLiveInTheObjectsFrame) {
  HostRound round = empty_round();
  for (int i = 0; i < 6; ++i) add_sample(round, {2 + 0.02F * static_cast<float>(i), 0, 0}, 7, {1, 0, 0});
  // The object stands at (2, 0, 0), turned a quarter about y.
  round.scene.objects[7] = Rigid{.rotation = glm::angleAxis(1.5707963F, glm::vec3(0, 1, 0)), .translation = {2, 0, 0}};
  const HostGaussians inserted = insert(round);
  ASSERT_EQ(inserted.size(), 6U);
  EXPECT_LT(glm::distance(inserted.mean[2], glm::vec3(0, 0, 0.04F)), 1e-5F);
  EXPECT_LT(glm::distance(inserted.normal[2], glm::vec3(0, 0, 1)), 1e-5F);
  EXPECT_EQ(inserted.object_id[2], 7U);
  // It moves on: the same surface is not inserted again.
  for (auto& position : round.position) position.x += 1;
  round.scene.objects[7].rigid.translation.x += 1;
  EXPECT_EQ(insert(round).size(), 0U);
}

TEST_P(InsertionTest, AnObjectThatGrowsOrShrinksKeepsItsGaussians) {
  ObjectTransform object =
      Rigid{.rotation = glm::angleAxis(0.7F, glm::normalize(glm::vec3(1, 2, 3))), .translation = {2, 0.5F, -1}};
  // A sheet of 0.4 m in its own frame, sampled at kSpacing of the world.
  const auto seen_at = [&](float scale) {
    object.scale = scale;
    HostRound round = empty_round();
    round.scene.objects[7] = object;
    const float step = kSpacing / scale;
    for (float x = step / 2; x < 0.4F; x += step) {
      for (float z = step / 2; z < 0.4F; z += step) {
        add_sample(round, object * glm::vec3(x, 0, z), 7, object.rigid.rotation * glm::vec3(0, 1, 0));
      }
    }
    return round;
  };
  const HostRound twice = seen_at(2);
  const HostGaussians inserted = insert(twice);
  ASSERT_EQ(inserted.size(), twice.size());
  for (std::size_t i = 0; i < inserted.size(); ++i) {
    EXPECT_LT(glm::distance(object * inserted.mean[i], twice.position[i]), 1e-5F);
    EXPECT_LT(glm::distance(inserted.normal[i], glm::vec3(0, 1, 0)), 1e-5F);
    EXPECT_NEAR(object.scale * std::exp(inserted.log_scale[i].x), options_.initial.scale * kSpacing, 1e-6F);
  }
  EXPECT_EQ(insert(seen_at(1)).size(), 0U) << "half as large: all of it is there";
  EXPECT_GT(insert(seen_at(8)).size(), twice.size()) << "four times as large: what is finer is new";
}

TEST_P(InsertionTest, WhatStandsStillBelongsToTheWorld) {
  HostRound round = empty_round();
  for (int i = 0; i < 6; ++i) add_sample(round, {2 + 0.02F * static_cast<float>(i), 0, 0}, 9);
  round.scene.objects[0] = Rigid{.translation = {5, 5, 5}};  // the world does not move
  for (const std::uint32_t mover : {4U, 12U}) round.scene.objects[mover] = Rigid{.translation = {1, 1, 1}};
  HostGaussians inserted = insert(round);
  ASSERT_EQ(inserted.size(), 6U);
  // Under its id it would be moved as soon as there is a transform, although it is in the world's frame.
  EXPECT_EQ(inserted.object_id, std::vector<std::uint32_t>(6, kWorldFrame));
  EXPECT_EQ(inserted.mean, round.position);
  for (auto& id : round.object_id) id = 0;
  EXPECT_EQ(insert(round).size(), 0U) << "the world, whatever its id";
}

TEST_P(InsertionTest, ObjectsWhoseIdsAgreeInManyBitsShareNoCells) {
  for (const std::uint32_t id : {5U, 5U + (1U << 18U), 5U + (1U << 24U), 5U + (1U << 31U)}) {
    HostRound round = empty_round();
    for (int i = 0; i < 6; ++i) add_sample(round, {0.02F * static_cast<float>(i), 0, 0}, id);
    round.scene.objects[id] = {};
    const HostGaussians inserted = insert(round);
    EXPECT_EQ(inserted.object_id, std::vector<std::uint32_t>(6, id));
  }
  EXPECT_EQ(inserter_->cells().modelled(), 4U);
}

TEST_P(InsertionTest, TheFarFieldIsInsertedWhereverViewersStand) {
  viewpoints_ = {{.position = {500, 2, 0}, .ahead = {500, 2, 0}, .focal_px = 100}};
  HostRound round = empty_round();
  for (int i = 0; i < 6; ++i) {
    add_sample(round, kFarFieldCentre + glm::vec3(0.02F * static_cast<float>(i), kFarFieldRadius, 0), kFarFieldFrame,
               {0, -1, 0});
  }
  round.scene.objects[kFarFieldFrame] = far_field();
  const HostGaussians inserted = insert(round);
  EXPECT_EQ(inserted.object_id, std::vector<std::uint32_t>(6, kFarFieldFrame));
  EXPECT_EQ(inserted.mean, round.position);
  EXPECT_EQ(insert(round).size(), 0U) << "seen again";
  std::ranges::fill(round.object_id, 0U);
  EXPECT_EQ(insert(round).size(), 0U) << "a surface so far away is left for later";
}

}  // namespace
}  // namespace splatbus::expander::test
