#include "sim/schedule.h"

#include <gtest/gtest.h>

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
    for (const std::uint32_t id : ids(schedule.due(frame / 10.0, 0))) ++rendered[id];
  }
  EXPECT_EQ(rendered[1], 100);
  EXPECT_EQ(rendered[2], 40);
  EXPECT_EQ(rendered[3], 100);
}

TEST(Schedule, WithoutARateOnceForEachRequest) {
  Schedule schedule;
  schedule.replace(std::vector{request(1, 0, 5)});
  EXPECT_EQ(schedule.due(0, 0).size(), 1U);
  EXPECT_EQ(schedule.due(1, 0).size(), 0U);
  schedule.replace(std::vector{request(1, 0, 5), request(2, 0, 6)});
  EXPECT_EQ(ids(schedule.due(2, 0)), std::vector{2U});
  schedule.replace(std::vector{request(1, 0, 7), request(2, 0, 6)});
  EXPECT_EQ(ids(schedule.due(3, 0)), std::vector{1U});
}

TEST(Schedule, AReplacedSetKeepsItsRhythm) {
  Schedule schedule;
  schedule.replace(std::vector{request(1, 1)});
  EXPECT_EQ(schedule.due(0, 0).size(), 1U);
  schedule.replace(std::vector{request(1, 1), request(9, 0)});
  EXPECT_EQ(ids(schedule.due(0.5, 0)), std::vector{9U});
  EXPECT_EQ(ids(schedule.due(1.0, 0)), std::vector{1U});
}

TEST(Schedule, OnlyNewCamerasAreNewcomers) {
  Schedule schedule;
  schedule.replace(std::vector{request(1, 0, 5), request(2, 2)});
  EXPECT_EQ(ids(schedule.newcomers(0, 0)), (std::vector{1U, 2U}));
  EXPECT_EQ(schedule.due(0, 0).size(), 0U) << "they are served";
  schedule.replace(std::vector{request(1, 0, 6), request(2, 2), request(3, 0)});
  EXPECT_EQ(ids(schedule.newcomers(0.1, 0)), std::vector{3U}) << "the first is known, and waits";
  EXPECT_EQ(ids(schedule.due(0.2, 0)), std::vector{1U});
  EXPECT_EQ(ids(schedule.due(0.5, 0)), std::vector{2U}) << "half a second after it was served";
}

TEST(Schedule, LightDepthFollowsTheScene) {
  Schedule schedule;
  schedule.replace(std::vector{request(1, 0, 1, SPLATBUS_ROLE_LIGHT), request(2, 0)});
  EXPECT_TRUE(schedule.watches_scene());
  EXPECT_EQ(schedule.due(0, 1).size(), 2U);
  EXPECT_EQ(schedule.due(1, 1).size(), 0U);
  EXPECT_EQ(ids(schedule.due(2, 2)), std::vector{1U});
}

TEST(Schedule, ProbesComeFirstAndALateEngineDoesNotCatchUp) {
  Schedule schedule;
  schedule.replace(std::vector{request(1, 10), request(2, 0, 1, SPLATBUS_ROLE_PROBE)});
  EXPECT_EQ(ids(schedule.due(0, 0)), (std::vector{2U, 1U}));
  EXPECT_EQ(schedule.due(5.0, 0).size(), 1U);
  EXPECT_EQ(schedule.due(5.05, 0).size(), 0U);
  EXPECT_EQ(schedule.due(5.1, 0).size(), 1U);
}

}  // namespace
}  // namespace splatbus::sim
