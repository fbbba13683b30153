#pragma once

#include "sim/scene.h"
#include "sim/world_plan.h"

namespace splatbus::sim {

/// Adds a figure of 1.7 m that walks in a circle on the middle crossing, and at two of its corners a turning cube and a
/// bouncing ball.
void add_world_life(Scene& scene, const WorldPlan& plan);

/// Where the cube turns, above a pedestal, and the ball bounces: corners of lawns.
[[nodiscard]] glm::vec2 cube_corner(const WorldPlan& plan);
[[nodiscard]] glm::vec2 ball_corner(const WorldPlan& plan);
inline constexpr float kPedestal_m = 0.8F;  ///< above the ground

}  // namespace splatbus::sim
