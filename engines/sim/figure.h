#pragma once

#include <array>
#include <cstddef>

#include "sim/scene.h"

namespace splatbus::sim {

/// The bones of the walking figure. Each is an object of its own, in this order, with its origin at the joint by which
/// it hangs: hips' middle, neck, shoulder, hip, knee, ankle.
enum class Bone : std::size_t {
  Torso,
  Head,
  RightArm,
  LeftArm,
  RightThigh,
  LeftThigh,
  RightShin,
  LeftShin,
  RightFoot,
  LeftFoot
};
inline constexpr std::size_t kBones = 10;

/// world_from_bone of the figure that walks at 0.4 m/s on a circle about the origin, outside of the toys. Bones look
/// along their -z and stand along their y. The foot that carries rests on the floor, y = 0.
[[nodiscard]] std::array<Pose, kBones> figure_at(double time_s);

/// Where a player's camera is that goes behind it: x right, y down, z forward.
[[nodiscard]] Pose figure_camera_at(double time_s);

/// Adds the bones, named "figure torso", "figure head", "figure right arm", ...
void add_figure(Scene& scene);
/// Adds the "figure camera".
void add_figure_camera(Scene& scene);

}  // namespace splatbus::sim
