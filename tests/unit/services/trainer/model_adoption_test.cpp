// What a trainer that is started again makes of the model that the one before left.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

#include "model_store_fixture.h"

namespace splatbus::trainer {
namespace {

using testing::AllOf;
using testing::HasSubstr;

TEST_F(ModelStoreTest, ARestartedTrainerGoesOnWithTheModel) {
  append(1, 60);
  append(2, 30);  // into a second slab
  for (int i = 0; i < 7; ++i) store_->add_step(2, 0.5);
  remove({5});
  const auto expected = by_id(store_->view());
  const auto generation = store_->structure().generation;
  restart();
  EXPECT_EQ(store_->origin(), "adopted 89 Gaussians at step 7");
  EXPECT_EQ(by_id(store_->view()), expected);
  EXPECT_EQ(store_->views(), 14U);
  EXPECT_DOUBLE_EQ(store_->optimizer_s(), 3.5);
  EXPECT_GT(store_->structure().generation, generation);
  EXPECT_TRUE(store_->holds(kEpoch, 2));
  append(3, 5);
  EXPECT_EQ(by_id(store_->view()).size(), 94U);
  EXPECT_EQ(publish_and_open()->live().count, 94U);
}

TEST_F(ModelStoreTest, OnlyRadianceMindsTheDegree) {
  append(1, 5);
  restart(64, {.appearance = Appearance::Transfer, .sh_degree = 1});
  EXPECT_EQ(store_->count(), 5U) << store_->origin();
  restart(64, {.appearance = Appearance::Radiance, .sh_degree = 1});
  EXPECT_EQ(store_->count(), 0U);
  append(2, 5);
  restart(64, {.appearance = Appearance::Radiance, .sh_degree = 2});
  EXPECT_EQ(store_->count(), 0U);
}

TEST_F(ModelStoreTest, ATrainerKilledWithinAChangeLeavesTheStructureBefore) {
  append(1, 20);
  const auto expected = by_id(store_->view());
  {
    const auto killed = connect("trainer");
    killed->adopt_slab("trainer/model")->begin_write(0);
  }
  restart();
  EXPECT_EQ(by_id(store_->view()), expected);
  EXPECT_TRUE(publish_and_open());
}

TEST_F(ModelStoreTest, ATrainerKilledWithinARemovalLeavesNothingTwice) {
  append(1, 20);
  auto expected = by_id(store_->view());
  expected.erase(store_->view().gaussian_id[3]);
  store_->planes().move_column(19, 3);     // and no more of the removal
  store_->planes().parameters[3] = 77.0F;  // the copy was still being trained, or was cut short itself
  restart();
  EXPECT_EQ(by_id(store_->view()), expected);
  EXPECT_EQ(store_->count(), 19U);
}

TEST_F(ModelStoreTest, WhatIsNotFiniteIsNotAdopted) {
  append(1, 20);
  store_->planes().parameters[8] = std::numeric_limits<float>::quiet_NaN();
  store_->planes().average[2 * 64 + 9] = std::numeric_limits<float>::infinity();
  restart();
  EXPECT_EQ(store_->count(), 18U);
}

TEST_F(ModelStoreTest, AnotherLayoutOrGarbageBeginsEmptyAndSaysWhy) {
  append(1, 20);
  restart(64, {.appearance = Appearance::Radiance, .sh_degree = 1});
  EXPECT_EQ(store_->count(), 0U);
  EXPECT_THAT(store_->origin(), HasSubstr("appearance"));

  restart();
  current_structure().capacity = 1U << 20;
  restart();
  EXPECT_THAT(store_->origin(), AllOf(HasSubstr("of no use"), HasSubstr("too small for a capacity")));
  current_structure().count = 65;
  restart();
  EXPECT_THAT(store_->origin(), HasSubstr("contradict"));
  header().current = 7;
  restart();
  EXPECT_THAT(store_->origin(), HasSubstr("no current structure"));

  context_->create_slab("model-header", 1, 100);
  restart();
  EXPECT_THAT(store_->origin(), HasSubstr("too small"));
  append(1, 20);
  EXPECT_EQ(publish_and_open()->live().count, 20U);
}

TEST_F(ModelStoreTest, AHeaderWithoutItsPlanesBeginsEmptyAndSaysWhy) {
  append(1, 20);
  context_->drop_slab("model");
  restart();
  EXPECT_EQ(store_->count(), 0U);
  EXPECT_THAT(store_->origin(), HasSubstr("planes are gone"));

  append(1, 20);
  context_->create_slab("model", 1, std::size_t{1} << 20);
  restart();
  EXPECT_EQ(store_->count(), 0U);
  EXPECT_THAT(store_->origin(), HasSubstr("planes of another model"));
}

TEST_F(ModelStoreTest, PlanesWithoutTheirHeaderBeginEmpty) {
  append(1, 20);
  context_->drop_slab("model-header");
  restart();
  EXPECT_EQ(store_->count(), 0U);
  EXPECT_EQ(store_->origin(), "empty");
  EXPECT_EQ(broker_->statistics().slabs, 2U);
}

TEST_F(ModelStoreTest, AMoveThatWasCutShortLeavesTheModelWhereItWas) {
  append(1, 20);
  const auto expected = by_id(store_->view());
  context_->create_slab("model-grown", 1, std::size_t{1} << 20);  // and killed before it counted
  restart();
  EXPECT_EQ(by_id(store_->view()), expected);
  EXPECT_EQ(broker_->statistics().slabs, 2U) << "what was left of the move is dropped";
}

}  // namespace
}  // namespace splatbus::trainer
