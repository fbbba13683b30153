#pragma once

#include <array>
#include <glm/glm.hpp>

#include "sdk/splatbus_engine.h"
#include "sim/mesh.h"

namespace splatbus::sim {

/// camera_from_world of the camera's pose.
[[nodiscard]] glm::mat4 camera_from_world(const splatbus_camera& camera);

enum class Projection { Pinhole, Orthographic };
/// Of role light, the sun's.
[[nodiscard]] Projection projection_by_role(const splatbus_camera& camera);

/// Clip space whose window rows run downwards as the picture's do (so front faces become clockwise).
[[nodiscard]] glm::mat4 clip_from_camera(const splatbus_camera& camera, Projection projection);
[[nodiscard]] inline glm::mat4 clip_from_camera(const splatbus_camera& camera) {
  return clip_from_camera(camera, projection_by_role(camera));
}

/// `world_from_camera` is a rotation.
void set_pose(splatbus_camera& camera, const glm::mat3& world_from_camera, const glm::vec3& eye);

/// A camera at `eye` towards `target`, world y up.
[[nodiscard]] splatbus_camera look_at(const glm::vec3& eye, const glm::vec3& target, std::uint32_t width,
                                      std::uint32_t height, float vertical_fov_deg);

/// A camera that looks down at the middle of `bounds` from +x and +z, as near as all of them are in the picture.
[[nodiscard]] splatbus_camera fit_camera(const Bounds& bounds, std::uint32_t width, std::uint32_t height,
                                         float vertical_fov_deg);
/// Moves the far plane away until all of `bounds` lies before it.
void reach(splatbus_camera& camera, const Bounds& bounds);

/// The orthographic camera that looks along the sun's rays and just holds `bounds`; the roll about its axis is the one
/// that wastes the least.
[[nodiscard]] splatbus_camera fit_light_camera(const Bounds& bounds, const glm::vec3& sun_direction,
                                               std::uint32_t width, std::uint32_t height);

/// What a picture can show lies on the positive side of six planes.
class Frustum {
 public:
  explicit Frustum(const glm::mat4& clip_from_world);
  /// Not when all of a box lies beyond one of the planes.
  [[nodiscard]] bool may_show(const Bounds& box_world) const;
  /// The greatest clip w in the box; of a pinhole camera metres along its axis.
  [[nodiscard]] float farthest(const Bounds& box_world) const;

 private:
  glm::vec4 w_;
  std::array<glm::vec4, 6> planes_{};
};

}  // namespace splatbus::sim
