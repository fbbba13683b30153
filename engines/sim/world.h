#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <vector>

#include "sim/scene.h"

namespace splatbus::sim {

/// A small town of 224 m by 224 m about the origin, in a shallow bowl: uneven ground, streets with kerbs and markings,
/// more than 40 houses that can be entered, gardens, a park, trees, street furniture and things in rooms. The seed
/// decides on all sizes, places, colours and patterns; nothing is there twice. Everything rests but for a figure that
/// walks about the middle crossing and a cube and a ball beside it, with `dynamics`.
///
/// Its still surfaces are a few hundred objects that are never listed. Where the ground is and which houses there are:
/// world_plan.h.
[[nodiscard]] Scene make_world(std::uint32_t seed, bool dynamics);

inline constexpr float kEyeHeight_m = 1.6F;
inline constexpr float kWalk_m = 420;

/// A walk through that world, as eye positions kEyeHeight_m above what one stands on, at most 0.5 m apart: 420 m long,
/// 300 s at 1.4 m/s. It begins beside the middle crossing, keeps to pavements and crossings, and enters houses by their
/// doors, at least three of them and one by its stairs to the upper rooms. It comes nowhere nearer than 0.25 m to still
/// geometry. Whatever moves keeps off it.
[[nodiscard]] std::vector<glm::vec3> world_walk(std::uint32_t seed);

}  // namespace splatbus::sim
