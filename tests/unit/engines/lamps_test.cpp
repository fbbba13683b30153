#include "sim/lamps.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "toy_renderer.h"

namespace splatbus::sim {
namespace {

glm::vec3 place(const splatbus_light_source& source) {
  return {source.position[0], source.position[1], source.position[2]};
}

TEST(Lamps, GlideOverTheToysOnClosedPaths) {
  Scene scene;
  add_lamps(scene);
  ASSERT_EQ(scene.lighting.sources.size(), kLamps);
  ASSERT_EQ(scene.objects.size(), kLamps);
  for (std::size_t lamp = 0; lamp < kLamps; ++lamp) {
    const LightSource& source = scene.lighting.sources[lamp];
    const Object& glass = scene.objects[lamp];
    EXPECT_EQ(glass.light_id, source.id);
    EXPECT_FALSE(glass.in_light_depth());
    constexpr double kStep_s = 0.02;
    double closest = 10;
    for (int i = 0; i < 2000; ++i) {
      const glm::vec3 here = place(*source.at(kStep_s * i)), next = place(*source.at(kStep_s * (i + 1)));
      ASSERT_LT(glm::distance(here, next), 1.0F * kStep_s) << "at most 1 m/s";
      ASSERT_GT(here.y, 1.2F) << "over everything that bounces";
      ASSERT_LT(std::hypot(here.x, here.z), 1.6F);
      ASSERT_LT(glm::distance(here, glass.motion(kStep_s * i)->translation), 1e-6F);
      if (i > 500) closest = std::min(closest, double{glm::distance(place(*source.at(0)), here)});
      const Bounds& origins = glass.motion_origins;
      ASSERT_TRUE(glm::all(glm::lessThanEqual(origins.low, here)) && glm::all(glm::lessThanEqual(here, origins.high)));
    }
    EXPECT_LT(closest, 0.02) << "lamp " << lamp + 1 << " returns";
  }
}

TEST(Lamps, ExistWithTheirLightsAndAreNothingWithoutThem) {
  Scene scene = make_toys(1, false);
  Renderer bare(shared_context(), scene);
  add_lamps(scene);
  scene.lighting.sources_on = 0;
  Renderer renderer(shared_context(), scene);
  const splatbus_camera camera = ring_camera(1.3F);
  const auto empty = bare.render(camera, kAll).color;
  EXPECT_EQ(renderer.render(camera, kAll).color, empty);
  const auto fitted = [](const Renderer& of) { return of.light_camera(0, 64, 64).fx; };
  EXPECT_EQ(fitted(renderer), fitted(bare)) << "the sun's camera is as without them";

  renderer.set_sources_on(3);
  renderer.set_time(2);
  ASSERT_EQ(renderer.instant().sources.size(), 3U);
  ASSERT_EQ(renderer.instant().objects.size(), 3U);
  for (std::size_t i = 0; i < 3; ++i) {
    const splatbus_object& glass = renderer.instant().objects[i];
    EXPECT_EQ(glass.flags, std::uint32_t{SPLATBUS_OBJECT_EMISSIVE});
    EXPECT_TRUE(std::ranges::equal(glass.world_from_object.translation, renderer.instant().sources[i].position));
    splatbus_camera_request request{};
    request.camera.width = request.camera.height = 32;
    request.light_id = renderer.instant().sources[i].id;
    for (request.light_map = 0; request.light_map < 6; ++request.light_map) {
      const auto& depth = renderer.render(*renderer.light_camera(request), SPLATBUS_BUFFER_LIGHT_DEPTH).light_depth;
      EXPECT_GT(std::ranges::min(depth), 0.2F);
    }
  }
  // The sun's map has no lamp in it.
  const splatbus_camera sun = renderer.light_camera(0, 256, 256);
  EXPECT_EQ(renderer.render(sun, SPLATBUS_BUFFER_LIGHT_DEPTH).light_depth,
            bare.render(sun, SPLATBUS_BUFFER_LIGHT_DEPTH).light_depth);
  const auto lit = renderer.render(camera, kAll).color;
  EXPECT_NE(lit, empty);

  renderer.show_lamps(false);
  renderer.set_time(2.05);
  EXPECT_EQ(renderer.instant().sources.size(), 3U);
  EXPECT_TRUE(renderer.instant().objects.empty());
  renderer.show_lamps(true);

  renderer.set_night(true);
  renderer.set_time(2.1);
  EXPECT_EQ(renderer.instant().light.sun_irradiance[0], 0);
  EXPECT_GT(renderer.instant().light.ambient_sh[0], 0);
  const auto sum = [](const std::vector<std::uint8_t>& color) {
    double total = 0;
    for (const std::uint8_t byte : color) total += byte;
    return total;
  };
  EXPECT_LT(sum(renderer.render(camera, kAll).color), 0.75 * sum(lit));
  renderer.set_night(false);
  renderer.set_sources_on(0);
  renderer.set_time(0);
  EXPECT_EQ(renderer.render(camera, kAll).color, empty);
}

}  // namespace
}  // namespace splatbus::sim
