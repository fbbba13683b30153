#include "sim/schedule.h"

#include <gtest/gtest.h>

#include <map>
#include <optional>

namespace splatbus::sim {
namespace {

splatbus_camera_request request(std::uint32_t id, float rate_hz, std::uint64_t request_id = 1,
                                std::uint32_t role = SPLATBUS_ROLE_REFERENCE) {
  splatbus_camera_request result{};
  result.camera.id = id;
  result.camera.role = role;
  result.rate_hz = rate_hz;
  result.request_id = request_id;
  return result;
}

/// Every light has every map, of this version.
Schedule::DepthVersion at_version(std::uint64_t version) {
  return [version](const splatbus_camera_request&) { return std::optional(version); };
}

std::vector<std::uint32_t> ids(const std::vector<splatbus_camera_request>& requests) {
  std::vector<std::uint32_t> result;
  for (const auto& entry : requests) result.push_back(entry.camera.id);
  return result;
}

TEST(Schedule, ARateGivesThatManyFramesASecond) {
  Schedule schedule;
  schedule.replace(std::vector{request(1, 10), request(2, 4), request(3, 100)});
  std::map<std::uint32_t, int> rendered;
  for (int frame = 0; frame < 100; ++frame) {
    for (const std::uint32_t id : ids(schedule.due(frame / 10.0, at_version(0)))) ++rendered[id];
  }
  EXPECT_EQ(rendered[1], 100);
  EXPECT_EQ(rendered[2], 40);
  EXPECT_EQ(rendered[3], 100);
}

TEST(Schedule, WithoutARateOnceForEachRequest) {
  Schedule schedule;
  schedule.replace(std::vector{request(1, 0, 5)});
  EXPECT_EQ(schedule.due(0, at_version(0)).size(), 1U);
  EXPECT_EQ(schedule.due(1, at_version(0)).size(), 0U);
  schedule.replace(std::vector{request(1, 0, 5), request(2, 0, 6)});
  EXPECT_EQ(ids(schedule.due(2, at_version(0))), std::vector{2U});
  schedule.replace(std::vector{request(1, 0, 7), request(2, 0, 6)});
  EXPECT_EQ(ids(schedule.due(3, at_version(0))), std::vector{1U});
}

TEST(Schedule, AReplacedSetKeepsItsRhythm) {
  Schedule schedule;
  schedule.replace(std::vector{request(1, 1)});
  EXPECT_EQ(schedule.due(0, at_version(0)).size(), 1U);
  schedule.replace(std::vector{request(1, 1), request(9, 0)});
  EXPECT_EQ(ids(schedule.due(0.5, at_version(0))), std::vector{9U});
  EXPECT_EQ(ids(schedule.due(1.0, at_version(0))), std::vector{1U});
}

TEST(Schedule, OnlyNewCamerasAreNewcomers) {
  Schedule schedule;
  schedule.replace(std::vector{request(1, 0, 5), request(2, 2)});
  EXPECT_EQ(ids(schedule.newcomers(0, at_version(0))), (std::vector{1U, 2U}));
  EXPECT_EQ(schedule.due(0, at_version(0)).size(), 0U) << "they are served";
  schedule.replace(std::vector{request(1, 0, 6), request(2, 2), request(3, 0)});
  EXPECT_EQ(ids(schedule.newcomers(0.1, at_version(0))), std::vector{3U}) << "the first is known, and waits";
  EXPECT_EQ(ids(schedule.due(0.2, at_version(0))), std::vector{1U});
  EXPECT_EQ(ids(schedule.due(0.5, at_version(0))), std::vector{2U}) << "half a second after it was served";
}

splatbus_camera_request map_request(std::uint32_t id, std::uint32_t light_id, std::uint32_t light_map = 0) {
  splatbus_camera_request result = request(id, 0, 1, SPLATBUS_ROLE_LIGHT);
  result.light_id = light_id;
  result.light_map = light_map;
  return result;
}

TEST(Schedule, ADepthMapFollowsItsOwnLight) {
  Schedule schedule;
  EXPECT_FALSE(schedule.watches_scene());
  schedule.replace(std::vector{map_request(1, 0), map_request(2, 7), map_request(3, 7, 1), request(4, 0)});
  EXPECT_TRUE(schedule.watches_scene());
  std::map<std::uint32_t, std::uint64_t> versions{{0, 5}, {7, 3}};
  const auto due_at = [&](double time_s) {
    return ids(schedule.due(time_s, [&](const auto& r) -> std::optional<std::uint64_t> {
      const auto found = versions.find(r.light_id);
      return found == versions.end() ? std::nullopt : std::optional(found->second);
    }));
  };
  EXPECT_EQ(due_at(0), (std::vector{1U, 2U, 3U, 4U}));
  EXPECT_EQ(due_at(1), std::vector<std::uint32_t>{});
  versions[7] = 4;
  EXPECT_EQ(due_at(2), (std::vector{2U, 3U}));
  versions[0] = 6;
  EXPECT_EQ(due_at(3), std::vector{1U});

  // Another map under the same id, and a rate, which does not count.
  std::vector next{map_request(1, 0), map_request(2, 7), map_request(3, 7, 2)};
  next[0].rate_hz = 50;
  schedule.replace(next);
  EXPECT_FALSE(schedule.repeats({SPLATBUS_ROLE_LIGHT, 1}));
  EXPECT_EQ(due_at(4), std::vector{3U});
  next[1].extent_m = 2;
  schedule.replace(next);
  EXPECT_EQ(due_at(5), std::vector{2U});
}

TEST(Schedule, ADepthMapWaitsForItsLight) {
  Schedule schedule;
  schedule.replace(std::vector{map_request(1, 9)});
  const auto none = [](const splatbus_camera_request&) { return std::optional<std::uint64_t>(); };
  EXPECT_EQ(schedule.newcomers(0, none).size(), 0U);
  EXPECT_EQ(schedule.due(0, none).size(), 0U);
  EXPECT_EQ(ids(schedule.due(1, at_version(1))), std::vector{1U});
  EXPECT_EQ(schedule.due(2, none).size(), 0U);
  EXPECT_EQ(schedule.due(3, at_version(1)).size(), 0U);
  EXPECT_EQ(schedule.due(4, at_version(2)).size(), 1U);
}

TEST(Schedule, WhatIsPostponedComesBeforeWhatIsDueLater) {
  Schedule schedule;
  schedule.replace(std::vector{request(1, 10), request(2, 10), request(3, 10)});
  // One picture a frame, ten frames a second: cameras take turns, none is left behind.
  std::map<std::uint32_t, int> rendered;
  for (int frame = 0; frame < 30; ++frame) {
    const auto due = schedule.due(frame / 10.0, at_version(0));
    ASSERT_EQ(due.size(), 3U) << frame;
    ++rendered[due.front().camera.id];
    for (std::size_t k = 1; k < due.size(); ++k) schedule.postpone(due[k]);
  }
  EXPECT_EQ(rendered[1], 10);
  EXPECT_EQ(rendered[2], 10);
  EXPECT_EQ(rendered[3], 10);
}

TEST(Schedule, ACameraThatIsAskedForAnewWhileItWaitsKeepsItsTurn) {
  Schedule schedule;
  std::map<std::uint32_t, int> rendered;
  for (int frame = 0; frame < 30; ++frame) {
    // Camera 3's request is another in every frame, as of an input that is asked for again and again.
    schedule.replace(
        std::vector{request(1, 10), request(2, 10), request(3, 0, 100 + static_cast<std::uint64_t>(frame))});
    const auto due = schedule.due(frame / 10.0, at_version(0));
    ASSERT_EQ(due.size(), 3U) << frame;
    ++rendered[due.front().camera.id];
    for (std::size_t k = 1; k < due.size(); ++k) schedule.postpone(due[k]);
  }
  EXPECT_EQ(rendered[3], 10);
}

TEST(Schedule, WhatIsPostponedIsNoNewcomer) {
  Schedule schedule;
  schedule.replace(std::vector{request(1, 0)});
  schedule.postpone(schedule.due(0, at_version(0)).front());
  EXPECT_TRUE(schedule.newcomers(0.1, at_version(0)).empty());
  EXPECT_EQ(ids(schedule.due(0.2, at_version(0))), std::vector{1U});
}

TEST(Schedule, LightsAndProbesComeFirstAndALateEngineDoesNotCatchUp) {
  Schedule schedule;
  schedule.replace(std::vector{request(1, 10), request(2, 0, 1, SPLATBUS_ROLE_PROBE), map_request(3, 0)});
  EXPECT_EQ(ids(schedule.due(0, at_version(0))), (std::vector{3U, 2U, 1U}));
  EXPECT_EQ(schedule.due(5.0, at_version(0)).size(), 1U);
  EXPECT_EQ(schedule.due(5.05, at_version(0)).size(), 0U);
  EXPECT_EQ(schedule.due(5.1, at_version(0)).size(), 1U);
}

}  // namespace
}  // namespace splatbus::sim
