#include "viewer/picture_age.h"

#include <gtest/gtest.h>

namespace splatbus::viewer {
namespace {

constexpr std::int64_t kMs = 1'000'000;

SceneState scene(std::uint64_t version, std::initializer_list<std::uint32_t> objects) {
  SceneState state;
  state.version = version;
  for (const std::uint32_t id : objects) state.objects[id] = {};
  return state;
}

TEST(PictureAges, AreFromTheInstantThatIsShown) {
  PictureAges ages;
  ages.drawn(scene(1, {}), {.shown_ns = 1000 * kMs, .finished_ns = 1040 * kMs});
  ages.drawn(scene(1, {}), {.shown_ns = 0, .finished_ns = 9999 * kMs});
  ASSERT_EQ(ages.ages().count(), 1U);
  EXPECT_DOUBLE_EQ(ages.ages().quantile(1), 40);
}

TEST(PictureAges, AnObjectHasChangedWithTheFirstPictureThatShowsIt) {
  PictureAges ages;
  ages.came(scene(1, {4}), 100 * kMs);
  ages.came(scene(1, {4, 7}), 1000 * kMs);
  ages.drawn(scene(1, {4, 7}), {.shown_ns = 990 * kMs, .finished_ns = 1001 * kMs});
  EXPECT_EQ(ages.object_changes().count(), 0U) << "before the first picture all is late";
  ages.came(scene(2, {4}), 1033 * kMs);
  ages.came(scene(3, {4}), 1066 * kMs);
  ages.drawn(scene(1, {4, 7}), {.shown_ns = 1000 * kMs, .finished_ns = 1070 * kMs});
  EXPECT_EQ(ages.object_changes().count(), 0U) << "it still shows";
  ages.drawn(scene(2, {4}), {.shown_ns = 1020 * kMs, .finished_ns = 1083 * kMs});
  ages.drawn(scene(2, {4}), {.shown_ns = 1030 * kMs, .finished_ns = 1100 * kMs});
  ASSERT_EQ(ages.object_changes().count(), 1U);
  EXPECT_DOUBLE_EQ(ages.object_changes().quantile(1), 50);
  ages.came(scene(4, {4, 9}), 2000 * kMs);
  ages.drawn(scene(4, {4, 9}), {.shown_ns = 2000 * kMs, .finished_ns = 2010 * kMs});
  ASSERT_EQ(ages.object_changes().count(), 2U);
  EXPECT_DOUBLE_EQ(ages.object_changes().quantile(0.5), 10);
}

TEST(PictureAges, WhatIsThereAgainBeforeAnyPictureIsAwaitedNoLonger) {
  PictureAges ages;
  ages.came(scene(1, {4}), 1000 * kMs);
  ages.drawn(scene(1, {4}), {});
  ages.came(scene(2, {}), 1010 * kMs);
  ages.came(scene(3, {4}), 1020 * kMs);
  ages.drawn(scene(3, {4}), {.shown_ns = 1020 * kMs, .finished_ns = 1025 * kMs});
  ASSERT_EQ(ages.object_changes().count(), 1U);
  EXPECT_DOUBLE_EQ(ages.object_changes().quantile(1), 5);
  ages.drawn(scene(3, {}), {.shown_ns = 1020 * kMs, .finished_ns = 1030 * kMs});
  EXPECT_EQ(ages.object_changes().count(), 1U);
}

TEST(PictureAges, VisibilityIsAheadByTheTimeBetweenItsSceneAndTheOneThatIsShown) {
  PictureAges ages;
  ages.came(scene(1, {}), 1000 * kMs);
  ages.came(scene(2, {}), 1033 * kMs);
  ages.drawn(scene(1, {}), {.shown_ns = 1005 * kMs, .finished_ns = 1040 * kMs, .visibility_version = 2});
  ages.drawn(scene(1, {}), {.shown_ns = 1025 * kMs, .finished_ns = 1060 * kMs, .visibility_version = 2});
  ages.drawn(scene(2, {}), {.shown_ns = 1030 * kMs, .finished_ns = 1060 * kMs, .visibility_version = 0});
  ASSERT_EQ(ages.visibility_leads().count(), 1U);
  EXPECT_DOUBLE_EQ(ages.visibility_leads().quantile(1), 28);
  EXPECT_EQ(ages.captured_ns(99), 1033 * kMs) << "a state between did not come";
  EXPECT_EQ(ages.captured_ns(0), 0);
}

}  // namespace
}  // namespace splatbus::viewer
