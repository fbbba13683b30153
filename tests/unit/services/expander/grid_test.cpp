#include "expander/grid.h"

#include <gtest/gtest.h>

#include <limits>
#include <set>

#include "expander/visibility.h"
#include "sample_scene.h"

namespace splatbus::expander {
namespace {

using test::add_floor;
using test::add_sample;
using test::empty_round;
using test::floor_round;
using test::kSpacing;

std::vector<Chosen> choose(Grid& grid, const InputSamples& samples) {
  return grid.choose(samples, seen_samples(samples, {}), {0, 1, 0});
}

TEST(Cell, PacksAndFindsNeighbours) {
  const Frame world;
  const auto cell = cell_at({1.3F, -0.6F, 0.05F}, world, 0.25F);
  ASSERT_TRUE(cell);
  EXPECT_EQ(*cell & kObjectCell, 0U);
  EXPECT_EQ(cell_centre(*cell, 0.25F), glm::vec3(1.25F, -0.5F, 0));
  EXPECT_EQ(cell_centre(*neighbour(*cell, -1, 1, 2), 0.25F), glm::vec3(1, -0.25F, 0.5F));
  EXPECT_EQ(neighbour(*neighbour(*cell, 3, -2, 1), -3, 2, -1), cell);
}

TEST(Cell, AFloorAtZeroLiesInOneLayer) {
  EXPECT_EQ(cell_at({0.6F, 1e-6F, 0.6F}, {}, 0.25F), cell_at({0.6F, -1e-6F, 0.6F}, {}, 0.25F));
}

TEST(Cell, ObjectsHaveCellsOfTheirOwn) {
  const Frame one{.local = true, .object_id = 1};
  const Frame two{.local = true, .object_id = 2};
  const glm::vec3 point(0.1F, 0.2F, -0.3F);
  const std::set<CellId> cells{*cell_at(point, {}, 0.25F), *cell_at(point, one, 0.25F), *cell_at(point, two, 0.25F)};
  EXPECT_EQ(cells.size(), 3U);
  EXPECT_EQ(cell_centre(*cell_at(point, one, 0.25F), 0.25F), glm::vec3(0, 0.25F, -0.25F));
  EXPECT_NE(*cell_at(point, two, 0.25F) & kObjectCell, 0U);
}

TEST(Cell, WhatIsTooFarOrNoNumberHasNone) {
  EXPECT_FALSE(cell_at({1e9F, 0, 0}, {}, 0.25F));
  EXPECT_FALSE(cell_at({std::numeric_limits<float>::quiet_NaN(), 0, 0}, {}, 0.25F));
  EXPECT_FALSE(cell_at({0, std::numeric_limits<float>::infinity(), 0}, {}, 0.25F));
  EXPECT_FALSE(cell_at({6000, 0, 0}, {.local = true, .object_id = 1}, 0.25F));
  const auto last = cell_at({((1 << 20) - 1) * 0.25F, 0, 0}, {}, 0.25F);
  ASSERT_TRUE(last);
  EXPECT_FALSE(neighbour(*last, 1, 0, 0));
}

TEST(Visibility, NeedsAngleAndDepth) {
  InputSamples samples = empty_round();
  add_sample(samples, {0.1F, 0, 0.1F});
  add_sample(samples, {0.1F, 0, 0.1F});
  samples.cosine[1] = 0.05F;                 // too oblique
  add_sample(samples, {0.1F, -0.5F, 0.1F});  // behind the floor
  add_sample(samples, {0.1F, 0.5F, 0.1F});   // in front of it, where the depth map has none
  add_sample(samples, {9, 0, 9});            // outside of the picture
  add_sample(samples, {0.1F, -0.5F, 0.1F}, 7);
  samples.objects[7] = {};  // may have moved since
  const auto seen = seen_samples(samples, {});
  EXPECT_EQ(seen, (std::vector<bool>{true, false, false, false, false, true}));
}

TEST(Grid, InsertsEverySampleOnce) {
  Grid grid({});
  const InputSamples round = floor_round(-1, 1);
  EXPECT_EQ(choose(grid, round).size(), round.size());
  EXPECT_EQ(grid.modelled_points(), round.size());
  EXPECT_EQ(grid.modelled_cells(), grid.seen_cells());
  EXPECT_TRUE(choose(grid, round).empty()) << "the same round again";
  EXPECT_TRUE(choose(grid, floor_round(-1, 1, 0.9F)).empty()) << "the same floor, sampled elsewhere";
  EXPECT_EQ(grid.modelled_points(), round.size());
}

TEST(Grid, ANewRegionJoinsWithoutGapOrDouble) {
  Grid grid({});
  const InputSamples left = floor_round(-1, 0);
  choose(grid, left);
  const InputSamples all = floor_round(-1, 1);
  const auto chosen = choose(grid, all);
  EXPECT_EQ(chosen.size(), all.size() - left.size());
}

TEST(Grid, ACellSeenAtItsBorderIsToppedUp) {
  Grid grid({.cell_size_m = 1});
  InputSamples strip = empty_round();
  for (int z = 0; z < 16; ++z) add_sample(strip, {-0.4F, 0, -0.4F + kSpacing * static_cast<float>(z)});
  EXPECT_EQ(choose(grid, strip).size(), 16U);
  const InputSamples whole = floor_round(-0.425F, 0.425F);
  const auto topped_up = choose(grid, whole);
  EXPECT_EQ(topped_up.size(), whole.size() - 16) << "all but those that are there";
  for (const Chosen& sample : topped_up) {
    for (const glm::vec3& there : strip.position) EXPECT_GT(glm::distance(sample.position, there), 0.5F * kSpacing);
  }
  EXPECT_TRUE(choose(grid, whole).empty());
}

TEST(Grid, ALittleThatIsNewIsNotWorthATopUp) {
  Grid grid({.cell_size_m = 1, .top_up_fraction = 0.1F});
  InputSamples almost = empty_round();
  add_floor(almost, -0.4F, 0.4F);
  InputSamples without = almost;
  for (auto* vectors : {&without.position, &without.normal, &without.albedo, &without.color}) vectors->resize(250);
  for (auto* scalars : {&without.spacing_m, &without.cosine}) scalars->resize(250);
  for (auto* ids : {&without.object_id, &without.camera}) ids->resize(250);
  EXPECT_EQ(choose(grid, without).size(), 250U);
  EXPECT_TRUE(choose(grid, almost).empty()) << "6 of 256 are missing";
}

TEST(Grid, BothSidesOfAThinSheetAreModelled) {
  Grid grid({});
  InputSamples samples = empty_round();
  for (int i = 0; i < 8; ++i) add_sample(samples, {0.02F * static_cast<float>(i), 0, 0});
  EXPECT_EQ(choose(grid, samples).size(), 8U);
  for (auto& normal : samples.normal) normal = -normal;
  EXPECT_EQ(choose(grid, samples).size(), 8U);
}

TEST(Grid, WhatLiesAloneIsNotSeenButSliversBesideASurfaceAre) {
  Grid grid({});
  InputSamples samples = floor_round(-0.5F, 0.5F);
  const std::size_t floor = samples.size();
  add_sample(samples, {0.6F, 0, 0});       // in the next cell, which it has for itself
  add_sample(samples, {-1.2F, 0, -1.2F});  // far from all
  EXPECT_EQ(choose(grid, samples).size(), floor + 1);
}

TEST(Grid, OnlyCandidatesAboutTheViewerAreTaken) {
  Grid grid({.candidate_radius_m = 1});
  const InputSamples samples = floor_round(-1, 1);
  const auto seen = seen_samples(samples, {});
  for (const Chosen& sample : grid.choose(samples, seen, {1, 0, 1})) {
    EXPECT_LE(glm::distance(sample.position, glm::vec3(1, 0, 1)), 1);
  }
  EXPECT_GT(grid.modelled_points(), 50U);
  EXPECT_FALSE(grid.choose(samples, seen, {-1, 0, -1}).empty()) << "when the viewer has come there";
}

TEST(Grid, SamplesOfMovingObjectsLiveInTheObjectsFrame) {
  Grid grid({});
  InputSamples samples = empty_round();
  for (int i = 0; i < 6; ++i) add_sample(samples, {2 + 0.02F * static_cast<float>(i), 0, 0}, 7, {1, 0, 0});
  // The object stands at (2, 0, 0), turned a quarter about y.
  samples.objects[7] = {.rotation = glm::angleAxis(1.5707963F, glm::vec3(0, 1, 0)), .translation = {2, 0, 0}};
  const auto chosen = choose(grid, samples);
  ASSERT_EQ(chosen.size(), 6U);
  EXPECT_LT(glm::distance(chosen[2].position, glm::vec3(0, 0, 0.04F)), 1e-5F);
  EXPECT_LT(glm::distance(chosen[2].normal, glm::vec3(0, 0, 1)), 1e-5F);
  EXPECT_NE(chosen[2].cell & kObjectCell, 0U);
  // It moves on: the same surface is not inserted again.
  for (auto& position : samples.position) position.x += 1;
  samples.objects[7].translation.x += 1;
  EXPECT_TRUE(choose(grid, samples).empty());
}

TEST(Grid, StopsWhereThereIsNoRoom) {
  Grid grid({});
  const InputSamples samples = floor_round(-1, 1);
  EXPECT_EQ(grid.choose(samples, seen_samples(samples, {}), {0, 1, 0}, 100).size(), 100U);
  EXPECT_EQ(grid.modelled_points(), 100U);
}

TEST(Grid, WhatTheModelHasAlreadyIsNotInserted) {
  Grid grid({});
  const InputSamples samples = floor_round(-1, 1);
  for (const glm::vec3& position : samples.position) grid.add_modelled({}, position, {0, 1, 0});
  EXPECT_TRUE(choose(grid, samples).empty());
  grid.clear();
  EXPECT_EQ(choose(grid, samples).size(), samples.size());
}

}  // namespace
}  // namespace splatbus::expander
