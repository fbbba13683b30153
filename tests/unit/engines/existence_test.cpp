// Objects that come and go: in the list, in pictures, in shadows.
#include <gmock/gmock.h>

#include <algorithm>
#include <glm/gtc/matrix_transform.hpp>

#include "sim/living_toys.h"
#include "toy_renderer.h"

namespace splatbus::sim {
namespace {

/// A floor and, from second 1 to 2, a block over it.
Scene scene_with_guest() {
  Scene scene;
  add_plain(scene, box({4, 0.1F, 4}), glm::vec3(0.5F));
  add_plain(scene, box({0.5F, 0.5F, 0.5F}), glm::vec3(0.3F, 0.5F, 0.2F));
  scene.objects.back().motion_origins.add({0, 0.6F, 0});
  scene.objects.back().motion = [](double time_s) {
    return time_s >= 1 && time_s < 2 ? std::optional(Pose{.translation = {0, 0.6F, 0}}) : std::nullopt;
  };
  return scene;
}

TEST(Existence, WhatDoesNotExistIsNeitherListedNorSeenNorShades) {
  Scene without = scene_with_guest();
  without.objects.pop_back();
  Renderer bare(shared_context(), without);
  Renderer renderer(shared_context(), scene_with_guest());
  const splatbus_camera camera = look_at({1, 3, 2}, {0, 0, 0}, 96, 96, 60);
  const Pictures empty = bare.render(camera, kAll);
  const auto expect_empty = [&] {
    const Pictures& pictures = renderer.render(camera, kAll);
    EXPECT_EQ(pictures.color, empty.color) << "its shadow is there";
    EXPECT_EQ(pictures.albedo, empty.albedo);
    EXPECT_EQ(pictures.object_id, empty.object_id);
    EXPECT_TRUE(renderer.instant().objects.empty());
  };
  // The cameras of light depth are the same with and without it.
  const splatbus_camera light = renderer.light_camera(0, 64, 64);
  const std::vector<float> empty_light = bare.render(light, SPLATBUS_BUFFER_LIGHT_DEPTH).light_depth;

  expect_empty();
  EXPECT_EQ(renderer.render(light, SPLATBUS_BUFFER_LIGHT_DEPTH).light_depth, empty_light);
  renderer.set_time(1.2);
  ASSERT_EQ(renderer.instant().objects.size(), 1U);
  EXPECT_EQ(renderer.instant().objects[0].id, 2U);
  const Pictures& seen = renderer.render(camera, kAll);
  EXPECT_GT(std::ranges::count(seen.object_id, 2U), 100);
  EXPECT_NE(renderer.render(light, SPLATBUS_BUFFER_LIGHT_DEPTH).light_depth, empty_light);
  renderer.set_time(2);
  expect_empty();
  EXPECT_EQ(renderer.render(light, SPLATBUS_BUFFER_LIGHT_DEPTH).light_depth, empty_light);
}

TEST(Existence, ChangesTheScenesVersion) {
  Renderer renderer(shared_context(), scene_with_guest());
  const auto version_at = [&](double time_s) {
    renderer.set_time(time_s);
    return renderer.scene_version();
  };
  const std::uint64_t before = version_at(0.5);
  EXPECT_EQ(version_at(0.9), before);
  const std::uint64_t there = version_at(1);
  EXPECT_GT(there, before);
  EXPECT_EQ(version_at(1.9), there);
  const std::uint64_t gone = version_at(2);
  EXPECT_GT(gone, there);
  EXPECT_EQ(version_at(3), gone);
  EXPECT_GT(version_at(1), gone) << "it returns to where it was";
}

TEST(Existence, TheListOfTheLivingToysFollowsTheirTimes) {
  const auto listed = [&](double time_s, const char* name) {
    toys().set_time(time_s);
    const Scene& scene = toys().scene();
    const auto object = std::ranges::find(scene.objects, name, &Object::name);
    const bool drawn = [&] {
      const Pictures& pictures = toys().render(look_at({0, 6, 0.01F}, {0, 0, 0}, 128, 128, 60), kAll);
      return std::ranges::find(pictures.object_id, object->id) != pictures.object_id.end();
    }();
    const bool in_list = std::ranges::count(toys().instant().objects, object->id, &splatbus_object::id) == 1;
    EXPECT_EQ(drawn, in_list) << name << " at " << time_s;
    return in_list;
  };
  EXPECT_TRUE(listed(LivingTimes::kVanish_s - 0.03, "skittle"));
  EXPECT_FALSE(listed(LivingTimes::kVanish_s, "skittle"));
  EXPECT_FALSE(listed(LivingTimes::kAppear_s - 0.03, "appearing crate"));
  EXPECT_TRUE(listed(LivingTimes::kAppear_s, "appearing crate"));
  EXPECT_FALSE(listed(LivingTimes::kRound_s + LivingTimes::kLeave_s, "drum"));
  EXPECT_TRUE(listed(LivingTimes::kRound_s + LivingTimes::kReturn_s, "drum"));
  toys().set_time(0);
}

}  // namespace
}  // namespace splatbus::sim
