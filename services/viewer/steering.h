#pragma once

#include <cstdint>
#include <optional>

#include "gaussians/camera.h"
#include "gaussians/light.h"
#include "viewer/rig.h"

struct GLFWwindow;

namespace splatbus::viewer {

/// A window's camera under mouse and keys.
class Steering {
 public:
  explicit Steering(const Camera& camera);
  void attach(GLFWwindow* window) { window_ = window; }

  /// A button went down: what follows moves the camera, or is somebody else's until all are up.
  void press(bool steers) { drags_ = steers; }
  void pointer(double to_x, double to_y);
  void scroll(double notches);
  /// Moves on to now; with `keys`, by those that are held.
  void advance(bool keys);
  /// A key that is pressed next moves from now on.
  void rest();

  [[nodiscard]] Camera camera(int width, int height) const;
  void frame(const glm::vec3& centre_m, float radius_m, const Camera& now);
  /// Begins to go where the player's camera is, or no more.
  void toggle_follow();
  [[nodiscard]] bool following() const { return followed_.has_value(); }
  /// As Window's.
  void follow(const SceneState& scene);

 private:
  [[nodiscard]] bool held(int key) const;
  [[nodiscard]] float axis(int more, int less) const;
  [[nodiscard]] bool shift() const;
  void fly(float step_s);

  GLFWwindow* window_ = nullptr;
  Rig rig_;
  float vertical_fov_;
  double x_ = 0, y_ = 0;
  bool drags_ = true;
  std::int64_t moved_ns_;
  std::optional<RigPose> followed_;  ///< where the player's camera was last
};

}  // namespace splatbus::viewer
