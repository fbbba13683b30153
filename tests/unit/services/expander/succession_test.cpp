// An expander that comes after another one.
#include <limits>

#include "expander/handover.h"
#include "expander_fixture.h"
#include "room_scene.h"

namespace splatbus::expander::test {
namespace {

TEST_P(ExpanderTest, ARestartedExpanderDoesNotDoubleTheModel) {
  start();
  const HostRound round = floor_round(-1, 1);
  publish_input(round);
  ASSERT_TRUE(settled_after(1));
  expander_.reset();
  start();
  EXPECT_EQ(expander_->model_sync().adoptions(), 1U);
  EXPECT_EQ(expander_->inserter().modelled().size(), round.size());
  publish_input(floor_round(-1, 1.5F));
  ASSERT_TRUE(settled_after(1));
  EXPECT_EQ(trainer_->points.size(), 2500U);
  EXPECT_EQ(distinct_points(), 2500U);
}

/// What was filled coarsely is filled once more where it is seen finely: who does not know at which spacing it was
/// filled takes what is there for enough.
TEST_P(ExpanderTest, TheNextOneRefinesWhatThisOneHasFilled) {
  HostRound finer = floor_round(-1, 1, 0.2F);
  for (float& spacing_m : finer.spacing_m) spacing_m *= 0.5F;
  std::map<std::string, std::size_t> added;
  for (const std::string end : {"none", "told", "killed"}) {
    start_trainer();
    start();
    publish_input(floor_round(-1, 1));
    ASSERT_TRUE(settled_after(1));
    const std::uint64_t seen = state().cells_seen();
    std::uint64_t rounds_before = 1;
    if (end != "none") {
      if (end == "told") expander_->leave_behind();
      expander_.reset();
      start();
      EXPECT_EQ(state().cells_seen(), end == "told" ? seen : 0) << end;
      rounds_before = 0;
    }
    const std::size_t before = trainer_->points.size();
    publish_input(finer);
    ASSERT_TRUE(settled_after(rounds_before + 1));
    added[end] = trainer_->points.size() - before;
    expander_.reset();
    trainer_.reset();
  }
  EXPECT_GT(added["none"], 100U);
  EXPECT_EQ(added["told"], added["none"]);
  EXPECT_EQ(added["killed"], 0U);
}

TEST_P(ExpanderTest, WhatCannotBeWhatAnExpanderLeftIsRefused) {
  CellTable cells(100);
  FilledCells filled;
  const CellKey key = cell_at({1, 2, 3}, 0, 0.1F);
  ASSERT_TRUE(filled.restore(key, 0.02F));
  cells.set_samples(std::vector<CellCount>{{.key = key, .count = 5}});
  const std::vector<std::uint8_t> good = write_handover(0.1F, cells, filled);
  CellTable next_cells(100);
  FilledCells next;
  EXPECT_THROW(read_handover(good, 0.2F, next_cells, next), bus::Error) << "cells of another size";
  EXPECT_THROW(read_handover(std::span(good).first(good.size() / 2), 0.1F, next_cells, next), bus::Error);
  ASSERT_TRUE(filled.restore({.object_id = 0, .level = kLevels, .code = 1}, 0.02F));
  EXPECT_THROW(read_handover(write_handover(0.1F, cells, filled), 0.1F, next_cells, next), bus::Error);
  filled.clear();
  ASSERT_TRUE(filled.restore(key, std::numeric_limits<float>::quiet_NaN()));
  EXPECT_THROW(read_handover(write_handover(0.1F, cells, filled), 0.1F, next_cells, next), bus::Error);
  EXPECT_EQ(next.size() + next_cells.size(), 0U);
  read_handover(good, 0.1F, next_cells, next);
  EXPECT_EQ(next.all().at(key), 0.02F);
  EXPECT_EQ(next_cells.sampled().front().count, 5U);
}

TEST_P(ExpanderTest, ARestartedExpanderKnowsMovingObjectsAndLeavesOutGarbage) {
  start();
  RoomScene scene;
  publish_input(room_round(scene, 3, 32));
  ASSERT_TRUE(settled_after(1));
  const std::size_t inserted = trainer_->points.size();
  ASSERT_GT(inserted, 2000U);
  for (const float x : {std::numeric_limits<float>::quiet_NaN(), 1e30F}) {
    trainer_->points.emplace_back(x, 0, 0);
    trainer_->normal.emplace_back(0, 1, 0);
    trainer_->object_id.push_back(RoomScene::kBall);
  }
  trainer_->publish();
  expander_.reset();
  start();
  EXPECT_EQ(expander_->model_sync().adoptions(), 1U);
  EXPECT_EQ(expander_->inserter().modelled().size(), inserted);
  publish_input(room_round(scene, 3, 32));
  ASSERT_TRUE(settled_after(1));
  EXPECT_EQ(expander_->queue().gaussians(), 0U) << "all of it is there";
}

TEST_P(ExpanderTest, AModelThatWasAdoptedAndIsLostIsMadeAnew) {
  start();
  publish_input(floor_round(-1, 1));
  ASSERT_TRUE(settled_after(1));
  expander_.reset();
  start();
  ASSERT_EQ(expander_->inserter().modelled().size(), 1600U);
  start_trainer();
  ASSERT_TRUE(until([&] { return expander_->inserter().modelled().size() == 0; }));
  publish_input(floor_round(-1, 1));
  ASSERT_TRUE(settled_after(1));
  EXPECT_EQ(trainer_->points.size(), 1600U);
}

}  // namespace
}  // namespace splatbus::expander::test
