#include "sim/world.h"

#include <gtest/gtest.h>

#include <map>
#include <set>
#include <string>

#include "sim/toys.h"
#include "sim/world_plan.h"
#include "world_triangles.h"

namespace splatbus::sim {
namespace {

/// Made once a seed, for it takes a while.
const Scene& world_of(std::uint32_t seed) {
  static std::map<std::uint32_t, Scene> made;
  const auto found = made.find(seed);
  return found != made.end() ? found->second : made.emplace(seed, make_world(seed, false)).first->second;
}

class WorldOfSeed : public testing::TestWithParam<std::uint32_t> {};

std::vector<glm::vec3> raised(std::vector<glm::vec3> feet) {
  for (glm::vec3& foot : feet) foot.y += kEyeHeight_m;
  return feet;
}

TEST_P(WorldOfSeed, TheWalkIsFreeAndStandsOnSomething) {
  const std::vector<glm::vec3> points = dense(world_walk(GetParam()));
  const TriangleGrid grid(world_of(GetParam()), points);
  for (const glm::vec3& p : points) {
    ASSERT_GT(grid.clearance(p), 0.25F) << p.x << ", " << p.y << ", " << p.z;
    ASSERT_NEAR(grid.height(p), kEyeHeight_m, 0.22F) << p.x << ", " << p.y << ", " << p.z;
  }
}

TEST_P(WorldOfSeed, EveryHouseCanBeEntered) {
  const WorldPlan plan = plan_world(GetParam());
  EXPECT_GE(plan.houses.size(), 40U);
  std::vector<glm::vec3> points;
  for (const HousePlan& house : plan.houses) {
    const std::vector<glm::vec3> tour = dense(raised(tour_of(house)));
    points.insert(points.end(), tour.begin(), tour.end());
  }
  const TriangleGrid grid(world_of(GetParam()), points);
  for (const glm::vec3& p : points) {
    ASSERT_GT(grid.clearance(p), 0.25F) << p.x << ", " << p.y << ", " << p.z;
    ASSERT_NEAR(grid.height(p), kEyeHeight_m, 0.22F) << p.x << ", " << p.y << ", " << p.z;
  }
}

INSTANTIATE_TEST_SUITE_P(Seeds, WorldOfSeed, testing::Values(1U, 2U, 3U));

}  // namespace
}  // namespace splatbus::sim
