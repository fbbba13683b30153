#include "sim/world_life.h"

#include <algorithm>
#include <cstddef>

#include "sim/figure.h"
#include "sim/living_toys.h"

namespace splatbus::sim {
namespace {

/// Moves the objects from `first` on to where their toys' floor is `world_from_toys`.
void place(Scene& scene, std::size_t first, const Pose& world_from_toys) {
  for (std::size_t i = first; i < scene.objects.size(); ++i) {
    Object& object = scene.objects[i];
    object.motion = [of_toys = object.motion, world_from_toys](double time_s) -> std::optional<Pose> {
      const std::optional<Pose> pose = of_toys(time_s);
      if (!pose) return std::nullopt;
      return world_from_toys * *pose;
    };
    object.motion_origins = transformed(object.motion_origins, matrix(world_from_toys));
    object.greatest_scale *= world_from_toys.scale;
  }
}

}  // namespace

glm::vec2 cube_corner(const WorldPlan& plan) {
  return plan.block(1, 1).high - 1.7F;
}

glm::vec2 ball_corner(const WorldPlan& plan) {
  const Rect park = plan.block(1, 2);
  return {park.high.x - 1.9F, park.low.y + 1.9F};
}

void add_world_life(Scene& scene, const WorldPlan& plan) {
  constexpr float kFigure = 2.2F, kCube = 2.6F, kBall = 2;
  const glm::vec2 crossing{plan.along_z[1].middle_m, plan.along_x[1].middle_m};
  std::size_t first = scene.objects.size();
  add_figure(scene);
  place(scene, first, {.translation = {crossing.x, plan.stand_m(crossing), crossing.y}, .scale = kFigure});

  const glm::vec2 cube = cube_corner(plan), ball = ball_corner(plan);
  first = scene.objects.size();
  add_cube(scene, {});
  place(scene, first, {.translation = {cube.x, plan.ground_m(cube) + kPedestal_m + 0.5F, cube.y}, .scale = kCube});
  first = scene.objects.size();
  add_ball(scene, {});
  float highest = plan.ground_m(ball);
  for (const glm::vec2& by : {glm::vec2(0.4F), glm::vec2(-0.4F), glm::vec2(0.4F, -0.4F), glm::vec2(-0.4F, 0.4F)})
    highest = std::max(highest, plan.ground_m(ball + by));
  place(scene, first, {.translation = {ball.x, highest + 0.02F, ball.y}, .scale = kBall});
}

}  // namespace splatbus::sim
