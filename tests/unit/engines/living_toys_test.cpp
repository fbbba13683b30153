#include "sim/living_toys.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <stdexcept>
#include <string>
#include <string_view>

#include "sim/figure.h"
#include "sim/toys.h"

namespace splatbus::sim {
namespace {

/// With everything that lives; made once, for its textures take a while.
const Scene& toys_of(std::uint32_t seed) {
  static std::map<std::uint32_t, Scene> made;
  const auto found = made.find(seed);
  return found != made.end() ? found->second : made.emplace(seed, make_toys(seed, true)).first->second;
}

const Object& named(const Scene& scene, std::string_view name) {
  const auto found = std::ranges::find(scene.objects, name, &Object::name);
  if (found == scene.objects.end()) throw std::runtime_error("no object is named " + std::string(name));
  return *found;
}

const Pose& of(const std::array<Pose, kBones>& bones, Bone bone) {
  return bones.at(static_cast<std::size_t>(bone));
}

glm::vec3 in_frame_of(const Pose& pose, const glm::vec3& world) {
  return glm::inverse(pose.rotation) * (world - pose.translation);
}

bool is_bone(const Object& object) {
  return object.name.starts_with("figure ") && object.id != SPLATBUS_PLAYER_ID;
}

/// Calls `visit` with the three corners, in the world, of every triangle of an object that exists at `time_s`.
template <class Visit>
void each_triangle(const Object& object, double time_s, Visit&& visit) {
  glm::mat4 world_from_object = object.world_from_object;
  if (object.motion) {
    const std::optional<Pose> pose = object.motion(time_s);
    if (!pose) return;
    world_from_object = matrix(*pose);
  }
  for (const Part& part : object.parts) {
    for (std::size_t i = 0; i < part.mesh.indices.size(); i += 3) {
      std::array<glm::vec3, 3> corners{};
      for (std::size_t k = 0; k < 3; ++k) {
        corners.at(k) = world_from_object * glm::vec4(part.mesh.vertices.at(part.mesh.indices[i + k]).position, 1);
      }
      visit(corners);
    }
  }
}

float lowest(const Object& object, double time_s) {
  float low = std::numeric_limits<float>::infinity();
  each_triangle(object, time_s, [&](const auto& corners) {
    for (const glm::vec3& corner : corners) low = std::min(low, corner.y);
  });
  return low;
}

float distance_to_segment(const glm::vec2& point, const glm::vec2& a, const glm::vec2& b) {
  const glm::vec2 along = b - a;
  const float length2 = glm::dot(along, along);
  const float t = length2 > 0 ? glm::clamp(glm::dot(point - a, along) / length2, 0.0F, 1.0F) : 0;
  return glm::distance(point, a + t * along);
}

TEST(LivingToys, ComeAndGoAtTheirTimes) {
  const Scene& scene = toys_of(1);
  const auto exists = [&](const char* name, double time_s) { return named(scene, name).motion(time_s).has_value(); };
  for (const double time_s : {0.0, 12.0, 19.99}) EXPECT_TRUE(exists("skittle", time_s)) << time_s;
  for (const double time_s : {20.0, 25.0, 1e6}) EXPECT_FALSE(exists("skittle", time_s)) << time_s;
  for (const double time_s : {0.0, 25.0, 39.99}) EXPECT_FALSE(exists("appearing crate", time_s)) << time_s;
  for (const double time_s : {40.0, 45.0, 1e6}) EXPECT_TRUE(exists("appearing crate", time_s)) << time_s;
  for (const double time_s : {0.0, 9.99, 15.0, 29.99, 30.0, 39.99, 45.0, 3015.0})
    EXPECT_TRUE(exists("drum", time_s)) << time_s;
  for (const double time_s : {10.0, 14.99, 40.0, 44.99, 3010.0, 3014.99})
    EXPECT_FALSE(exists("drum", time_s)) << time_s;
  EXPECT_EQ(*named(scene, "drum").motion(9), *named(scene, "drum").motion(16)) << "it returns to its place";
}

/// Of an object that stands on the floor: within its greatest distance from its vertical axis there is nothing else.
void expect_touches_no_other(const Scene& scene, const Object& visitor, double time_s) {
  const glm::vec3 place = visitor.motion(time_s)->translation;
  EXPECT_NEAR(lowest(visitor, time_s), 0, 1e-4F) << "it stands on the floor";
  const glm::vec2 middle{place.x, place.z};
  float radius = 0;
  each_triangle(visitor, time_s, [&](const auto& corners) {
    for (const glm::vec3& c : corners) radius = std::max(radius, glm::distance(middle, {c.x, c.z}));
  });
  for (const Object& other : scene.objects) {
    if (other.name == "floor" || other.name == visitor.name) continue;
    each_triangle(other, time_s, [&](const auto& corners) {
      for (std::size_t k = 0; k < 3; ++k) {
        const glm::vec3 &a = corners.at(k), &b = corners.at((k + 1) % 3);
        ASSERT_GT(distance_to_segment(middle, {a.x, a.z}, {b.x, b.z}), radius) << visitor.name << " in " << other.name;
      }
    });
  }
}

TEST(LivingToys, TouchNoOther) {
  for (const std::uint32_t seed : {1U, 2U, 3U, 4U}) {
    const Scene& scene = toys_of(seed);
    for (const char* name : {"skittle", "appearing crate", "drum"}) {
      const Object& visitor = named(scene, name);
      expect_touches_no_other(scene, visitor, visitor.motion(0) ? 0 : 50);
    }
  }
}

TEST(LivingToys, ThePotBreathesWhereItStands) {
  constexpr double kLargest_s = 1.25;
  for (const std::uint32_t seed : {1U, 2U, 3U, 4U}) {
    Scene scene = toys_of(seed);
    add_breathing_toy(scene);
    const Object& pot = named(scene, "breathing pot");
    float least = 10, greatest = 0;
    for (int i = 0; i < 500; ++i) {
      const Pose pose = *pot.motion(0.013 * i);
      least = std::min(least, pose.scale);
      greatest = std::max(greatest, pose.scale);
      ASSERT_EQ(pose.translation, pot.motion(0)->translation);
    }
    EXPECT_NEAR(least, kLeastBreath, 1e-3F);
    EXPECT_NEAR(greatest, kGreatestBreath, 1e-3F);
    EXPECT_NEAR(pot.motion(kLargest_s)->scale, kGreatestBreath, 1e-6F);
    EXPECT_NEAR(lowest(pot, kLargest_s), 0, 1e-6F);
    expect_touches_no_other(scene, pot, kLargest_s);
  }
}

TEST(Figure, WalksOutsideOfTheToysAndOnTheFloor) {
  const Scene& scene = toys_of(1);
  float toys = 0;
  for (const std::uint32_t seed : {1U, 2U, 3U, 4U}) {
    for (const Object& object : toys_of(seed).objects) {
      if (object.name == "floor" || is_bone(object)) continue;
      each_triangle(object, 0, [&](const auto& corners) {
        for (const glm::vec3& c : corners) toys = std::max(toys, std::hypot(c.x, c.z));
      });
    }
  }
  float inner = 10, outer = 0;
  for (int i = 0; i < 200; ++i) {
    const double time_s = 0.163 * i;  // all of a round, and every phase of a step
    float low = 10;
    for (const Object& object : scene.objects) {
      if (!is_bone(object)) continue;
      each_triangle(object, time_s, [&](const auto& corners) {
        for (const glm::vec3& c : corners) {
          inner = std::min(inner, std::hypot(c.x, c.z));
          outer = std::max(outer, std::hypot(c.x, c.z));
          low = std::min(low, c.y);
        }
      });
    }
    ASSERT_NEAR(low, 0, 1e-4F) << "no foot below the floor, and one on it, at " << time_s;
  }
  EXPECT_GT(inner, toys);
  EXPECT_LT(outer, 2.5F);
}

TEST(Figure, ItsCameraGoesBehindIt) {
  for (int i = 0; i < 40; ++i) {
    const Pose camera = figure_camera_at(0.9 * i);
    const Pose torso = of(figure_at(0.9 * i), Bone::Torso);
    const glm::vec3 seen = in_frame_of(camera, torso.translation);
    EXPECT_GT(seen.z, 0.5F);
    EXPECT_LT(glm::length(glm::vec2(seen)) / seen.z, std::tan(glm::pi<float>() / 6)) << "it is in the picture";
    EXPECT_GT((camera.rotation * glm::vec3(0, -1, 0)).y, 0.8F) << "upright";
    EXPECT_NEAR((camera.rotation * glm::vec3(1, 0, 0)).y, 0, 1e-5F) << "level";
    const glm::vec3 ahead = torso.rotation * glm::vec3(0, 0, -1);
    EXPECT_LT(glm::dot(camera.translation - torso.translation, ahead), -0.3F) << "behind";
  }
}

TEST(Figure, ItsBonesStayJointed) {
  const auto first = figure_at(0);
  constexpr std::array<std::pair<Bone, Bone>, 7> kJoints{{{Bone::Torso, Bone::Head},
                                                          {Bone::Torso, Bone::RightArm},
                                                          {Bone::Torso, Bone::LeftArm},
                                                          {Bone::RightThigh, Bone::RightShin},
                                                          {Bone::LeftThigh, Bone::LeftShin},
                                                          {Bone::RightShin, Bone::RightFoot},
                                                          {Bone::LeftShin, Bone::LeftFoot}}};
  for (int i = 0; i < 2000; ++i) {
    const auto bones = figure_at(37.3 * i);
    for (const Pose& bone : bones) ASSERT_NEAR(glm::length(bone.rotation), 1, 1e-5F);
    for (const auto& [from, to] : kJoints) {
      const glm::vec3 joint = in_frame_of(of(bones, from), of(bones, to).translation);
      const glm::vec3 rest = in_frame_of(of(first, from), of(first, to).translation);
      ASSERT_LT(glm::distance(joint, rest), 1e-4F) << static_cast<int>(from) << " to " << static_cast<int>(to);
    }
  }
}

/// What makes it a walk: one foot stays where it is while the body moves on, then the other; knees bend forwards, and
/// arms swing against the legs.
TEST(Figure, CarriesItsBodyOverFeetThatRest) {
  constexpr double kStep_s = 0.01;
  int carried = 0;
  float most_bent = 0, least_bent = 10;
  for (int i = 0; i < 1000; ++i) {
    const auto now = figure_at(kStep_s * i);
    const auto next = figure_at(kStep_s * (i + 1));
    const auto speed = [&](Bone bone) {
      return glm::distance(of(now, bone).translation, of(next, bone).translation) / static_cast<float>(kStep_s);
    };
    EXPECT_NEAR(speed(Bone::Torso), 0.4F, 0.06F);
    const bool right = speed(Bone::RightFoot) < 0.03F;
    const bool left = speed(Bone::LeftFoot) < 0.03F;
    carried += right || left ? 1 : 0;
    const glm::vec3 knee = in_frame_of(of(now, Bone::RightThigh), of(now, Bone::RightFoot).translation);
    most_bent = std::max(most_bent, knee.z);
    least_bent = std::min(least_bent, knee.z);
  }
  // Not at the instants in which a foot comes down or leaves.
  EXPECT_GT(carried, 970);
  EXPECT_GT(least_bent, 0) << "a shin behind its thigh (+z), never before it";
  EXPECT_GT(most_bent, least_bent + 0.05F);

  const auto forwards = [](const std::array<Pose, kBones>& bones, Bone bone, const glm::vec3& tip) {
    const Pose& pose = of(bones, bone);
    return -in_frame_of(of(bones, Bone::Torso), pose.rotation * tip + pose.translation).z;
  };
  double together = 0;
  for (int i = 0; i < 1000; ++i) {
    const auto bones = figure_at(kStep_s * i);
    together += forwards(bones, Bone::RightArm, {0, -0.1F, 0}) * forwards(bones, Bone::RightThigh, {0, -0.1F, 0});
  }
  EXPECT_LT(together, 0);
}

}  // namespace
}  // namespace splatbus::sim
