#include "viewer/steering.h"

#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "bus/clock.h"
#include "gaussians/player.h"

namespace splatbus::viewer {

namespace {

constexpr float kRadiansAPixel = 0.006F;
constexpr float kZoomANotch = 0.9F;
constexpr float kZoomASecond = 2.5F;
constexpr float kTurnASecond = 1.2F;  // radians
constexpr float kLongestStep_s = 0.1F;

}  // namespace

Steering::Steering(const Camera& camera)
    : rig_(RigPose::of(camera)),
      vertical_fov_(2 * std::atan(static_cast<float>(camera.height) / (2 * camera.fy))),
      moved_ns_(bus::now_ns()) {}

bool Steering::held(int key) const {
  return glfwGetKey(window_, key) == GLFW_PRESS;
}

float Steering::axis(int more, int less) const {
  return static_cast<float>(held(more)) - static_cast<float>(held(less));
}

bool Steering::shift() const {
  return held(GLFW_KEY_LEFT_SHIFT) || held(GLFW_KEY_RIGHT_SHIFT);
}

void Steering::pointer(double to_x, double to_y) {
  const auto dx = static_cast<float>(to_x - x_), dy = static_cast<float>(to_y - y_);
  x_ = to_x;
  y_ = to_y;
  if (!drags_) return;
  const auto button = [this](int which) { return glfwGetMouseButton(window_, which) == GLFW_PRESS; };
  const bool left = button(GLFW_MOUSE_BUTTON_LEFT);
  if (button(GLFW_MOUSE_BUTTON_RIGHT) || button(GLFW_MOUSE_BUTTON_MIDDLE) || (left && shift())) {
    int width = 0, height = 0;
    glfwGetWindowSize(window_, &width, &height);
    rig_.pan(dx, dy, static_cast<float>(std::max(height, 1)) / (2 * std::tan(vertical_fov_ / 2)));
  } else if (left) {
    rig_.orbit(dx * kRadiansAPixel, dy * kRadiansAPixel);
  }
}

void Steering::scroll(double notches) {
  rig_.zoom(std::pow(kZoomANotch, static_cast<float>(notches)));
}

void Steering::fly(float step_s) {
  const RigMotion motion{.right = axis(GLFW_KEY_D, GLFW_KEY_A),
                         .up = axis(GLFW_KEY_E, GLFW_KEY_Q),
                         .ahead = axis(GLFW_KEY_W, GLFW_KEY_S),
                         .fast = shift()};
  if (motion.right != 0 || motion.up != 0 || motion.ahead != 0) rig_.fly(motion, step_s);
  const float turn = kTurnASecond * step_s;
  const float right = axis(GLFW_KEY_RIGHT, GLFW_KEY_LEFT), up = axis(GLFW_KEY_UP, GLFW_KEY_DOWN);
  if (right != 0 || up != 0) rig_.look(right * turn, -up * turn);
  const float nearer = axis(GLFW_KEY_EQUAL, GLFW_KEY_MINUS) + axis(GLFW_KEY_KP_ADD, GLFW_KEY_KP_SUBTRACT);
  if (nearer != 0) rig_.zoom(std::pow(kZoomASecond, -nearer * step_s));
}

void Steering::advance(bool keys) {
  const std::int64_t now_ns = bus::now_ns();
  const float seconds = static_cast<float>(now_ns - std::exchange(moved_ns_, now_ns)) / 1e9F;
  if (keys) fly(std::min(seconds, kLongestStep_s));
  rig_.advance(seconds);
}

void Steering::rest() {
  moved_ns_ = bus::now_ns();
}

Camera Steering::camera(int width, int height) const {
  return rig_.camera(static_cast<std::uint32_t>(std::max(width, 8)), static_cast<std::uint32_t>(std::max(height, 8)),
                     vertical_fov_);
}

void Steering::frame(const glm::vec3& centre_m, float radius_m, const Camera& now) {
  const auto least = static_cast<float>(std::min(now.width, now.height));
  rig_.frame(centre_m, radius_m, 2 * std::atan(least / (2 * now.fy)));
}

void Steering::toggle_follow() {
  followed_ = followed_ ? std::nullopt : std::optional(rig_.goal());
}

void Steering::follow(const SceneState& scene) {
  const auto player = scene.objects.find(kPlayerId);
  if (!followed_ || player == scene.objects.end()) return;
  if (!(rig_.goal() == *followed_)) {  // somebody steers
    followed_.reset();
    return;
  }
  rig_.jump(RigPose::of({.world_from_camera = player->second.rigid}));
  followed_ = rig_.goal();
}

}  // namespace splatbus::viewer
