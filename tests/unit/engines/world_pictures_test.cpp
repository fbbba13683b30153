// What is left out of a picture of the world would not have been seen in it.
#include <gtest/gtest.h>

#include <algorithm>
#include <glm/gtc/matrix_transform.hpp>

#include "gl/objects.h"
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

TEST(WorldPictures, LeaveOutWhatIsNotSeen) {
  // Twenty balls behind a wall.
  const Mesh ball = sphere(0.3F, 24);
  const auto triangles = [&](bool cull, const glm::vec3& eye, const glm::vec3& target = {0, 0, 0}) {
    Scene scene;
    add_plain(scene, box({8, 4, 0.2F}), {0.5F, 0.5F, 0.5F});
    for (int i = 0; i < 20; ++i) {
      add_plain(scene, ball, {0.5F, 0.2F, 0.2F},
                glm::translate(glm::mat4(1), {0.3F * static_cast<float>(i) - 3, 0, -2}));
      scene.objects.back().enclosed = true;
    }
    Renderer renderer(shared_context(), std::move(scene), {.cull = cull});
    const splatbus_camera camera = look_at(eye, target, kSize, kSize, 60);
    const GlQuery drawn = make_query(GL_PRIMITIVES_GENERATED);
    glBeginQuery(GL_PRIMITIVES_GENERATED, drawn.get());
    static_cast<void>(renderer.render(camera, SPLATBUS_BUFFER_DEPTH));
    glEndQuery(GL_PRIMITIVES_GENERATED);
    GLuint count = 0;
    glGetQueryObjectuiv(drawn.get(), GL_QUERY_RESULT, &count);
    return count;
  };
  const std::size_t all = 20 * ball.indices.size() / 3;
  EXPECT_GE(triangles(false, {0, 0, 5}), all);
  EXPECT_LT(triangles(true, {0, 0, 5}), all / 20) << "the wall and boxes: it hides all balls";
  EXPECT_GE(triangles(true, {0, 0, -9}), all) << "from behind they are seen";
  EXPECT_EQ(triangles(true, {0, 0, 5}, {0, 0, 9}), 0U) << "nothing is in view";
}

TEST(WorldPictures, WhatIsEnclosedIsSeenWhereItComesOut) {
  const auto scene = [] {
    Scene made;
    add_plain(made, box({2, 2, 1}), {0.5F, 0.5F, 0.5F});
    add_plain(made, box({0.6F, 0.6F, 0.6F}), {0.5F, 0.2F, 0.2F});
    Object& hidden = made.objects.back();
    hidden.enclosed = true;
    hidden.motion = [](double time_s) { return Pose{.translation = {time_s, 0, -1}}; };
    hidden.motion_origins = {.low = {0, 0, -1}, .high = {3, 0, -1}};
    return made;
  };
  Renderer culled(shared_context(), scene()), whole(shared_context(), scene(), {.cull = false});
  for (const double time_s : {0.0, 2.5, 0.0, 1.4}) {
    culled.set_time(time_s);
    whole.set_time(time_s);
    const splatbus_camera camera = look_at({0, 0, 5}, {0, 0, 0}, kSize, kSize, 60);
    const Pictures seen = culled.render(camera, kAll);
    expect_same(seen, whole.render(camera, kAll));
    EXPECT_EQ(std::ranges::count(seen.object_id, 2U) > 0, time_s > 0) << time_s;
  }
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
