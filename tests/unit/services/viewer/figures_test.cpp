#include "viewer/ui/figures.h"

#include <gmock/gmock.h>

namespace splatbus::viewer {
namespace {

using testing::Contains;
using testing::Pair;

constexpr std::int64_t kMillisecond = 1'000'000;

TEST(FiguresTest, PicturesHaveARateWhileSomethingMoves) {
  FrameRate rate;
  EXPECT_FALSE(rate.frame_ms(0));
  std::int64_t now_ns = 5000 * kMillisecond;
  for (int i = 0; i < 50; ++i) rate.drawn(now_ns += 20 * kMillisecond);
  EXPECT_NEAR(rate.frame_ms(now_ns).value(), 20, 0.01);
  EXPECT_FALSE(rate.frame_ms(now_ns + 2500 * kMillisecond)) << "at rest";
  rate.drawn(now_ns += 10'000 * kMillisecond);
  rate.drawn(now_ns += 10 * kMillisecond);
  EXPECT_NEAR(rate.frame_ms(now_ns).value(), 10, 0.01) << "the rest counts as a picture";
}

TEST(FiguresTest, BytesHaveARateOverAFewSecondsAndMayBeCountedAnew) {
  ByteRate rate;
  EXPECT_EQ(rate.megabits(), 0);
  for (int i = 0; i <= 100; ++i) rate.add(100L * i * kMillisecond, static_cast<std::uint64_t>(i) * 25'000);
  EXPECT_NEAR(rate.megabits(), 2, 0.01);
  rate.add(10'100 * kMillisecond, 0);
  EXPECT_EQ(rate.megabits(), 0);
}

TEST(FiguresTest, WhatIsNotKnownIsLeftOutOrADash) {
  EXPECT_THAT(figure_rows({}, {}, 1),
              testing::ElementsAre(Pair("Frames/s", "at rest"), Pair("Frame", "-"), Pair("Resolution", "100 %")));
  const StreamFigures stream{
      .connected = true, .megabits = 1.5, .max_kbps = 5000, .round_trip_ms = 12.4, .age_ms = {}, .missing_pages = 3};
  const auto rows = figure_rows({.held = 1'234'567, .drawn = 999, .stream = stream}, 4.25, 0.35F);
  EXPECT_THAT(rows, Contains(Pair("Frames/s", "235")));
  EXPECT_THAT(rows, Contains(Pair("Gaussians", "1,234,567")));
  EXPECT_THAT(rows, Contains(Pair("Drawn", "999")));
  EXPECT_THAT(rows, Contains(Pair("Mbit/s", "1.50 of 5")));
  EXPECT_THAT(rows, Contains(Pair("Round trip", "12 ms")));
  EXPECT_THAT(rows, Contains(Pair("Picture age", "-")));
  EXPECT_THAT(rows, Contains(Pair("Missing", "3 pages")));
  EXPECT_THAT(rows, Contains(Pair("Connection", "Connected")));
}

}  // namespace
}  // namespace splatbus::viewer
