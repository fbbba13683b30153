#include "viewer/gl/draw_choice.h"

#include <gtest/gtest.h>

#include "bus/parameters.h"
#include "viewer/viewer.h"

namespace splatbus::viewer::gl {
namespace {

/// Draws pictures that cost as much by each way, until no trial is under way; how many that took.
int try_out(DrawChoice& choice, std::size_t rows, double quads_ms, double tiles_ms) {
  int pictures = 0;
  for (; pictures < 1000; ++pictures) {
    const Way way = choice.next(rows);
    if (choice.trial() == 0) break;
    choice.took(choice.trial(), way, way == Way::Quads ? quads_ms : tiles_ms);
  }
  return pictures;
}

TEST(DrawChoice, IsTheFasterWay) {
  DrawChoice choice;
  EXPECT_LE(try_out(choice, 1000, 10, 1), 20);
  EXPECT_EQ(choice.next(1000), Way::Tiles);
  EXPECT_EQ(choice.cost_ms(Way::Quads), 10);
  EXPECT_EQ(choice.cost_ms(Way::Tiles), 1);
  DrawChoice other;
  try_out(other, 1000, 1, 10);
  EXPECT_EQ(other.next(1000), Way::Quads);
}

TEST(DrawChoice, IsMadeAnewWhenTheModelIsFourTimesAsLargeOrAsSmall) {
  DrawChoice choice;
  EXPECT_GT(try_out(choice, 1000, 1, 10), 0);
  EXPECT_EQ(try_out(choice, 3999, 10, 1), 0);
  EXPECT_EQ(try_out(choice, 251, 10, 1), 0);
  EXPECT_EQ(choice.next(3999), Way::Quads);
  EXPECT_GT(try_out(choice, 4000, 10, 1), 0);
  EXPECT_EQ(choice.next(4000), Way::Tiles);
  EXPECT_GT(try_out(choice, 1000, 1, 10), 0);
  EXPECT_EQ(choice.next(1000), Way::Quads);
}

TEST(DrawChoice, WaitsForAModel) {
  DrawChoice choice;
  EXPECT_EQ(choice.next(0), Way::Quads);
  EXPECT_EQ(choice.trial(), 0U);
  static_cast<void>(choice.next(1));
  EXPECT_NE(choice.trial(), 0U);
}

TEST(DrawChoice, OfPicturesThatAreSlowAtFirstTakesTheLater) {
  DrawChoice choice;
  int tiles = 0;
  for (Way way = choice.next(10); choice.trial() != 0; way = choice.next(10)) {
    const bool warm = way == Way::Quads || ++tiles > 2;
    choice.took(choice.trial(), way, way == Way::Quads ? 2 : warm ? 1 : 500);
  }
  EXPECT_EQ(choice.next(10), Way::Tiles);
  EXPECT_EQ(choice.cost_ms(Way::Tiles), 1);
}

TEST(DrawChoice, TakesNothingOfATrialThatBeganAnew) {
  DrawChoice choice;
  static_cast<void>(choice.next(10));
  const unsigned void_trial = choice.trial();
  choice.try_again();
  for (int k = 0; k < 50; ++k) {
    choice.took(void_trial, Way::Quads, 1);
    choice.took(void_trial, Way::Tiles, 10);
  }
  EXPECT_NE(choice.trial(), 0U);
  try_out(choice, 10, 10, 1);
  EXPECT_EQ(choice.next(10), Way::Tiles);
}

TEST(DrawChoice, IsNotMadeWhereItIsGiven) {
  for (const Way way : {Way::Quads, Way::Tiles}) {
    DrawChoice choice(way == Way::Quads ? Draw::Quads : Draw::Tiles);
    EXPECT_EQ(try_out(choice, 1000, way == Way::Quads ? 10 : 1, way == Way::Quads ? 1 : 10), 0);
    EXPECT_EQ(choice.next(1000), way);
    EXPECT_EQ(choice.next(1'000'000), way);
  }
}

TEST(DrawChoice, IsAParameter) {
  bus::Parameters parameters(bus::Parameters::declare<Options>());
  EXPECT_EQ(parameters.read<Options>().draw, Draw::Auto);
  EXPECT_EQ(parameters.set("draw", "tiles", false), "");
  EXPECT_EQ(parameters.read<Options>().draw, Draw::Tiles);
  EXPECT_EQ(parameters.set("draw", "quads", false), "");
  EXPECT_EQ(parameters.read<Options>().draw, Draw::Quads);
  EXPECT_NE(parameters.set("draw", "points", false), "");
}

}  // namespace
}  // namespace splatbus::viewer::gl
