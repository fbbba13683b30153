// What is left out of a picture of the world would not have been seen in it.
#include <gtest/gtest.h>

#include "sim/world.h"
#include "toy_renderer.h"

namespace splatbus::sim {
namespace {

constexpr std::uint32_t kSize = 64;

/// A copy of the one that was made.
Scene world() {
  static const Scene made = make_world(1, true);
  return made;
}

TEST(WorldPictures, AreTheSameWithoutCulling) {
  Renderer culled(shared_context(), world());
  Renderer whole(shared_context(), world(), {.cull = false});
  const std::vector<glm::vec3> walk = world_walk(1);
  // On the street, before and in a house, on its stairs, and from above.
  for (const std::size_t at : {0U, 80U, 120U, 160U, 400U}) {
    const glm::vec3 eye = walk.at(at), ahead = walk.at(at + 3);
    const Pictures seen = culled.render(look_at(eye, ahead, kSize, kSize, 75), kAll);
    expect_same(seen, whole.render(look_at(eye, ahead, kSize, kSize, 75), kAll));
  }
  const Pictures above = culled.render(look_at({-30, 60, -40}, {0, 0, 0}, kSize, kSize, 60), kAll);
  expect_same(above, whole.render(look_at({-30, 60, -40}, {0, 0, 0}, kSize, kSize, 60), kAll));
  const Pictures light = culled.render(culled.light_camera(0, kSize, kSize), SPLATBUS_BUFFER_LIGHT_DEPTH);
  expect_same(light, whole.render(whole.light_camera(0, kSize, kSize), SPLATBUS_BUFFER_LIGHT_DEPTH));
}

TEST(WorldPictures, ShadowsOfWhatMovesAreWhereTheyWouldBeDrawnAnew) {
  Renderer going(shared_context(), world());
  const glm::vec3 eye = world_walk(1).front();
  const splatbus_camera camera = look_at(eye, {0, 0, 0}, kSize, kSize, 60);
  Pictures moved;
  for (const double time_s : {0.0, 0.7, 4.1, 9.3}) {
    going.set_time(time_s);
    moved = going.render(camera, SPLATBUS_BUFFER_COLOR);
  }
  Renderer fresh(shared_context(), world());
  fresh.set_time(9.3);
  EXPECT_EQ(moved.color, fresh.render(camera, SPLATBUS_BUFFER_COLOR).color);
  fresh.set_time(0);
  EXPECT_NE(moved.color, fresh.render(camera, SPLATBUS_BUFFER_COLOR).color);
}

}  // namespace
}  // namespace splatbus::sim
