#pragma once

#include <glm/glm.hpp>

#include "gaussians/camera.h"

namespace splatbus::viewer {

/// A camera that looks at a target, as the page's (web/src/camera/rig.ts).
struct RigPose {
  glm::vec3 target_m{0, 0.4F, 0};
  float yaw = 0;        ///< radians, from +x towards +z: where the camera is
  float pitch = 0.38F;  ///< radians above the level
  float distance_m = 4.3F;
  bool operator==(const RigPose&) const = default;

  [[nodiscard]] glm::vec3 backward() const;
  [[nodiscard]] glm::vec3 right() const;
  [[nodiscard]] glm::vec3 eye() const { return target_m + distance_m * backward(); }
  /// What a camera looks at: where its view meets the floor, or a few metres ahead.
  [[nodiscard]] static RigPose of(const Camera& camera);
};

/// To the right, up as the world has it, and to where one looks, each in [-1, 1] of the full speed.
struct RigMotion {
  float right = 0, up = 0, ahead = 0;
  bool fast = false;
};

/// Where the camera should be, and where it is on its way there.
class Rig {
 public:
  explicit Rig(const RigPose& pose) { jump(pose); }

  [[nodiscard]] const RigPose& goal() const { return goal_; }
  [[nodiscard]] const RigPose& shown() const { return shown_; }
  [[nodiscard]] Camera camera(std::uint32_t width, std::uint32_t height, float vertical_fov_radians) const;

  /// There at once.
  void jump(const RigPose& pose);
  void move(const RigPose& pose);
  /// About the target; radians.
  void orbit(float yaw, float pitch);
  /// About the eye.
  void look(float yaw, float pitch);
  /// What is at the target's distance follows by as many pixels of a picture of that focal length.
  void pan(float right_px, float down_px, float focal_px);
  /// Times the distance.
  void zoom(float factor);
  void fly(const RigMotion& motion, float seconds);
  /// All of a sphere, from where the camera looks now.
  void frame(const glm::vec3& centre, float radius_m, float least_fov_radians);
  /// Comes nearer to the goal; false when it is there.
  bool advance(float seconds);

 private:
  RigPose goal_, shown_;
};

}  // namespace splatbus::viewer
