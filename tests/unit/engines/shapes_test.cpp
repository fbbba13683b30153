#include <gtest/gtest.h>

#include <algorithm>
#include <set>

#include "sim/mesh.h"
#include "sim/patterns.h"
#include "sim/toys.h"

namespace splatbus::sim {
namespace {

/// Volume by the divergence theorem: positive when the triangles of a closed mesh face outwards.
float volume(const Mesh& mesh) {
  float sum = 0;
  for (std::size_t i = 0; i < mesh.indices.size(); i += 3) {
    const auto at = [&](std::size_t k) { return mesh.vertices[mesh.indices[i + k]].position; };
    sum += glm::dot(at(0), glm::cross(at(1), at(2))) / 6;
  }
  return sum;
}

TEST(Shapes, EncloseTheirVolumes) {
  constexpr float kPi = 3.14159265F;
  EXPECT_NEAR(volume(box({1, 2, 3})), 6, 1e-4F);
  EXPECT_NEAR(volume(sphere(1, 64)), 4 * kPi / 3, 0.05F);
  EXPECT_NEAR(volume(cylinder(1, 2, 64)), 2 * kPi, 0.05F);
  EXPECT_NEAR(volume(cone(1, 3, 64)), kPi, 0.05F);
  EXPECT_NEAR(volume(capsule(1, 2, 64)), 4 * kPi / 3 + 2 * kPi, 0.1F);
  EXPECT_NEAR(volume(torus(2, 0.5F, 64, 32)), 2 * kPi * kPi * 2 * 0.25F, 0.1F);
}

TEST(Shapes, HaveUnitNormalsThatFaceAsTheirTrianglesDo) {
  const Scene toys = make_toys(3, true);
  for (const Object& object : toys.objects) {
    for (const Part& part : object.parts) {
      for (const Vertex& vertex : part.mesh.vertices) ASSERT_NEAR(glm::length(vertex.normal), 1, 1e-4F) << object.name;
      for (std::size_t i = 0; i < part.mesh.indices.size(); i += 3) {
        const Vertex& a = part.mesh.vertices.at(part.mesh.indices[i]);
        const Vertex& b = part.mesh.vertices.at(part.mesh.indices[i + 1]);
        const Vertex& c = part.mesh.vertices.at(part.mesh.indices[i + 2]);
        const glm::vec3 face = glm::cross(b.position - a.position, c.position - a.position);
        ASSERT_GT(glm::dot(glm::normalize(face), glm::normalize(a.normal + b.normal + c.normal)), 0.7F) << object.name;
      }
    }
  }
}

TEST(Toys, AreManyAndStandWithinTheirCircle) {
  const Scene toys = make_toys(1, false);
  ASSERT_GE(toys.objects.size(), 15U);
  std::set<std::uint32_t> ids;
  for (const Object& object : toys.objects) {
    EXPECT_TRUE(ids.insert(object.id).second);
    EXPECT_GT(object.id, 0U);
    if (object.name == "floor") continue;
    Bounds bounds;
    for (const Part& part : object.parts) {
      for (const Vertex& vertex : part.mesh.vertices) {
        bounds.add(glm::vec3(object.world_from_object * glm::vec4(vertex.position, 1)));
      }
    }
    EXPECT_GT(bounds.low.y, -0.02F) << object.name;
    const glm::vec3 middle = (bounds.low + bounds.high) / 2.0F;
    EXPECT_LT(glm::length(glm::vec2(middle.x, middle.z)), 1.9F) << object.name;
  }
  EXPECT_EQ(toys.objects.front().id, 1U);
  EXPECT_EQ(toys.objects.front().name, "floor");
}

TEST(Toys, FollowTheirSeedAndMoveOnlyWithDynamics) {
  const Scene first = make_toys(1, false);
  const Scene again = make_toys(1, false);
  const Scene other = make_toys(2, true);
  EXPECT_EQ(first.objects[3].world_from_object, again.objects[3].world_from_object);
  EXPECT_EQ(first.images[0].rgba, again.images[0].rgba);
  EXPECT_NE(first.objects[3].world_from_object, other.objects[3].world_from_object);
  EXPECT_NE(first.images[0].rgba, other.images[0].rgba);
  const auto moving = [](const Scene& scene) {
    return std::ranges::count_if(scene.objects, [](const Object& object) { return static_cast<bool>(object.motion); });
  };
  EXPECT_EQ(moving(first), 0);
  EXPECT_EQ(moving(other), 16) << "the figure's camera among them";
}

TEST(Toys, BoundsHoldWhatMovesAtAnyTime) {
  const Scene scene = make_toys(1, true);
  for (const bool casters : {true, false}) {
    const Bounds bounds = scene.bounds(casters);
    for (const Object& object : scene.objects) {
      if (!object.motion || object.parts.empty()) continue;  // a camera is no part of the picture
      Bounds local;
      for (const Part& part : object.parts) local.add(bounds_of(part.mesh));
      for (int i = 0; i < 20000; ++i) {
        // Steps that share no period with bounce, circle or spin: 5 hours of places, also long after a restart.
        const std::optional<Pose> pose = object.motion(0.917 * i);
        if (!pose) continue;
        const Bounds& origins = object.motion_origins;
        ASSERT_TRUE(glm::all(glm::lessThanEqual(origins.low, pose->translation + 1e-5F))) << object.name;
        ASSERT_TRUE(glm::all(glm::greaterThanEqual(origins.high, pose->translation - 1e-5F))) << object.name;
        const Bounds there = transformed(local, matrix(*pose));
        ASSERT_TRUE(glm::all(glm::lessThanEqual(bounds.low, there.low + 1e-5F))) << object.name << " at " << 0.917 * i;
        ASSERT_TRUE(glm::all(glm::greaterThanEqual(bounds.high, there.high - 1e-5F))) << object.name;
      }
    }
  }
  // The ball's highest place, which no sample of the time need meet.
  Scene ball = make_toys(1, true);
  std::erase_if(ball.objects, [](const Object& object) { return object.name != "bouncing ball"; });
  EXPECT_NEAR(ball.bounds(true).high.y, 0.16F + 0.7F + 0.16F * std::sqrt(3.0F), 0.01F);
}

}  // namespace
}  // namespace splatbus::sim
