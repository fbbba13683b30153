#include "viewer/rig.h"

#include <algorithm>
#include <cmath>

namespace splatbus::viewer {
namespace {

constexpr float kSteepest = 1.5F;
constexpr float kNearest_m = 0.05F, kFarthest_m = 1e4F;
constexpr float kSpeed = 0.8F;   // distances to the target a second
constexpr float kSlowest_m = 1;  // a second: who looks at a thing from near wants to leave it, too
constexpr float kFaster = 4;
constexpr float kFramed = 0.75F;       // of the sphere about all: its corners are empty
constexpr float kSmoothing_s = 0.06F;  // of the way to the goal 1/e is left after this
constexpr float kArrived = 1e-4F;

RigPose limited(RigPose pose) {
  pose.pitch = std::clamp(pose.pitch, -kSteepest, kSteepest);
  pose.distance_m = std::clamp(pose.distance_m, kNearest_m, kFarthest_m);
  return pose;
}

}  // namespace

glm::vec3 RigPose::backward() const {
  return {std::cos(pitch) * std::cos(yaw), std::sin(pitch), std::cos(pitch) * std::sin(yaw)};
}

glm::vec3 RigPose::right() const {
  return {std::sin(yaw), 0, -std::cos(yaw)};
}

RigPose RigPose::of(const Camera& camera) {
  const glm::vec3 eye = camera.world_from_camera.translation;
  const glm::vec3 forward = camera.world_from_camera.rotation * glm::vec3(0, 0, 1);
  RigPose pose;
  pose.distance_m = forward.y < -0.05F && eye.y > 0.1F ? std::min(-eye.y / forward.y, 20.0F) : 3.0F;
  pose.target_m = eye + forward * pose.distance_m;
  pose.pitch = std::asin(std::clamp(-forward.y, -1.0F, 1.0F));
  pose.yaw = std::atan2(-forward.z, -forward.x);
  return pose;
}

Camera Rig::camera(std::uint32_t width, std::uint32_t height, float vertical_fov_radians) const {
  return look_at(shown_.eye(), shown_.target_m, width, height, vertical_fov_radians);
}

void Rig::jump(const RigPose& pose) {
  goal_ = shown_ = limited(pose);
}

void Rig::move(const RigPose& pose) {
  goal_ = limited(pose);
}

void Rig::orbit(float yaw, float pitch) {
  RigPose pose = goal_;
  pose.yaw += yaw;
  pose.pitch += pitch;
  move(pose);
}

void Rig::look(float yaw, float pitch) {
  const glm::vec3 eye = goal_.eye();
  RigPose pose = goal_;
  pose.yaw += yaw;
  pose.pitch += pitch;
  pose = limited(pose);
  pose.target_m = eye - pose.distance_m * pose.backward();
  move(pose);
}

void Rig::pan(float right_px, float down_px, float focal_px) {
  RigPose pose = goal_;
  const glm::vec3 up = glm::cross(pose.right(), -pose.backward());
  const float metres = pose.distance_m / focal_px;
  pose.target_m += -right_px * metres * pose.right() + down_px * metres * up;
  move(pose);
}

void Rig::zoom(float factor) {
  RigPose pose = goal_;
  pose.distance_m *= factor;
  move(pose);
}

void Rig::fly(const RigMotion& motion, float seconds) {
  RigPose pose = goal_;
  const float step_m = std::max(kSpeed * pose.distance_m, kSlowest_m) * (motion.fast ? kFaster : 1) * seconds;
  pose.target_m += step_m * (motion.right * pose.right() - motion.ahead * pose.backward() + glm::vec3(0, motion.up, 0));
  move(pose);
}

void Rig::frame(const glm::vec3& centre, float radius_m, float least_fov_radians) {
  RigPose pose = goal_;
  pose.target_m = centre;
  pose.distance_m = kFramed * radius_m / std::sin(least_fov_radians / 2);
  move(pose);
}

bool Rig::advance(float seconds) {
  if (shown_ == goal_) return false;
  const float part = 1 - std::exp(-seconds / kSmoothing_s);
  RigPose next;
  next.target_m = glm::mix(shown_.target_m, goal_.target_m, part);
  next.yaw = glm::mix(shown_.yaw, goal_.yaw, part);
  next.pitch = glm::mix(shown_.pitch, goal_.pitch, part);
  next.distance_m = std::exp(glm::mix(std::log(shown_.distance_m), std::log(goal_.distance_m), part));
  const float left = glm::distance(next.eye(), goal_.eye()) / goal_.distance_m + std::abs(next.yaw - goal_.yaw) +
                     std::abs(next.pitch - goal_.pitch);
  shown_ = left < kArrived ? goal_ : next;
  return true;
}

}  // namespace splatbus::viewer
