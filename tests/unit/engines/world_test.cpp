#include "sim/world.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
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

TEST_P(WorldOfSeed, TheWalkIsAsLongAsSaidAndEntersHouses) {
  const std::vector<glm::vec3> walk = world_walk(GetParam());
  float length = 0;
  for (std::size_t i = 1; i < walk.size(); ++i) {
    length += glm::distance(walk[i - 1], walk[i]);
    EXPECT_LE(glm::distance(walk[i - 1], walk[i]), 0.56F) << i;  // on the stairs, steps go up too
  }
  EXPECT_NEAR(length, kWalk_m, 1);
  const WorldPlan plan = plan_world(GetParam());
  int entered = 0, upstairs = 0;
  for (const HousePlan& house : plan.houses) {
    const glm::mat4 house_from_world = glm::inverse(house.world_from_house());
    bool inside = false, above = false;
    for (const glm::vec3& eye : walk) {
      const glm::vec3 p = house_from_world * glm::vec4(eye, 1);
      const bool here = std::abs(p.x) < house.inner_half().x && std::abs(p.z) < house.inner_half().y;
      inside = inside || here;
      above = above || (here && p.y > house.storey_m() + 1);
    }
    entered += inside ? 1 : 0;
    upstairs += above ? 1 : 0;
  }
  EXPECT_GE(entered, 3);
  EXPECT_GE(upstairs, 1);
  EXPECT_EQ(walk.size(), world_walk(GetParam()).size());
}

TEST_P(WorldOfSeed, NothingIsThereTwice) {
  // Objects' meshes, moved to their first vertex; houses have frames of their own, so that a turn does not hide one.
  std::set<std::vector<int>> shapes;
  for (const Object& object : world_of(GetParam()).objects) {
    std::vector<int> shape;
    const glm::vec3 origin = object.parts.front().mesh.vertices.front().position;
    for (const Part& part : object.parts) {
      for (const Vertex& vertex : part.mesh.vertices) {
        for (int axis = 0; axis < 3; ++axis) {
          shape.push_back(static_cast<int>(std::lround(1000 * (vertex.position[axis] - origin[axis]))));
        }
      }
    }
    EXPECT_TRUE(shapes.insert(std::move(shape)).second) << object.name;
  }
}

/// Triangles, and meshes with a texture.
struct Content {
  std::size_t triangles = 0, surfaces = 0;
};
Content content_of(const Scene& scene) {
  Content content;
  for (const Object& object : scene.objects) {
    for (const Part& part : object.parts) {
      content.triangles += part.mesh.indices.size() / 3;
      content.surfaces += scene.materials.at(static_cast<std::size_t>(part.material)).image >= 0 ? 1U : 0U;
    }
  }
  return content;
}

TEST_P(WorldOfSeed, HoldsAHundredTimesTheToys) {
  const Scene& world = world_of(GetParam());
  const Content content = content_of(world), toys = content_of(make_toys(1, false));
  EXPECT_GE(content.triangles, 100 * toys.triangles);
  EXPECT_GE(content.surfaces, 100 * toys.surfaces);
  const Bounds bounds = world.bounds(false);
  EXPECT_GE(bounds.high.x - bounds.low.x, 200);
  EXPECT_GE(bounds.high.z - bounds.low.z, 200);
  std::size_t texels = 0;
  for (const Image& image : world.images) texels += image.rgba.size();
  EXPECT_LE(texels, std::size_t{64} << 20U);
}

TEST(World, IsTheSameForTheSameSeedAlone) {
  const auto same = [](const Scene& a, const Scene& b) {
    const auto vertex = [](const Vertex& x, const Vertex& y) {
      return x.position == y.position && x.normal == y.normal && x.uv == y.uv && x.tint == y.tint;
    };
    return std::ranges::equal(a.objects, b.objects,
                              [&](const Object& x, const Object& y) {
                                return x.id == y.id && x.name == y.name && x.world_from_object == y.world_from_object &&
                                       std::ranges::equal(x.parts, y.parts, [&](const Part& p, const Part& q) {
                                         return p.material == q.material && p.mesh.indices == q.mesh.indices &&
                                                std::ranges::equal(p.mesh.vertices, q.mesh.vertices, vertex);
                                       });
                              }) &&
           std::ranges::equal(a.images, b.images, {}, &Image::rgba, &Image::rgba);
  };
  EXPECT_TRUE(same(world_of(1), make_world(1, false)));
  EXPECT_FALSE(same(world_of(1), world_of(2)));
}

TEST(World, ListsOnlyWhatLives) {
  EXPECT_EQ(
      std::ranges::count_if(world_of(1).objects, [](const Object& object) { return static_cast<bool>(object.motion); }),
      0);
  const Scene living = make_world(1, true);
  EXPECT_EQ(living.objects.size(), world_of(1).objects.size() + 12);
  const glm::vec3 start = world_walk(1).front();
  for (const Object& object : living.objects) {
    if (!object.motion) continue;
    for (const double time_s : {0.0, 3.3, 1000.7}) {
      EXPECT_LT(glm::distance(object.motion(time_s).value().translation, start), 25) << object.name;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Seeds, WorldOfSeed, testing::Values(1U, 2U, 3U));

}  // namespace
}  // namespace splatbus::sim
