#include "gaussians/camera.h"

#include <cmath>

namespace splatbus {

Rigid inverse(const Rigid& a_from_b) {
  const glm::quat b_from_a = glm::conjugate(a_from_b.rotation);
  return {b_from_a, -(b_from_a * a_from_b.translation)};
}

Rigid operator*(const Rigid& a_from_b, const Rigid& b_from_c) {
  return {glm::normalize(a_from_b.rotation * b_from_c.rotation), a_from_b * b_from_c.translation};
}

glm::vec3 operator*(const Rigid& a_from_b, const glm::vec3& point_b) {
  return a_from_b.rotation * point_b + a_from_b.translation;
}

Camera look_at(const glm::vec3& eye, const glm::vec3& target, std::uint32_t width, std::uint32_t height,
               float vertical_fov_radians) {
  const glm::vec3 offset = target - eye;
  const glm::vec3 forward = glm::length(offset) > 0 ? glm::normalize(offset) : glm::vec3(0, 0, -1);
  // Straight up or down the world's y says nothing about the roll: then the top of the picture is towards -z.
  const bool vertical = std::abs(forward.y) > 1.0F - 1e-6F;
  const glm::vec3 up = vertical ? glm::vec3(0, 0, -1) : glm::vec3(0, 1, 0);
  const glm::vec3 right = glm::normalize(glm::cross(forward, up));
  const glm::vec3 down = glm::cross(forward, right);

  Camera camera;
  camera.width = width;
  camera.height = height;
  camera.cx = 0.5F * static_cast<float>(width);
  camera.cy = 0.5F * static_cast<float>(height);
  camera.fy = camera.cy / std::tan(0.5F * vertical_fov_radians);
  camera.fx = camera.fy;
  camera.world_from_camera = {glm::normalize(glm::quat_cast(glm::mat3(right, down, forward))), eye};
  return camera;
}

glm::vec3 project(const Camera& camera, const glm::vec3& point_world) {
  const glm::vec3 p = inverse(camera.world_from_camera) * point_world;
  const float scale = camera.role == CameraRole::Light ? 1.0F : 1.0F / p.z;
  return {camera.fx * p.x * scale + camera.cx, camera.fy * p.y * scale + camera.cy, p.z};
}

glm::vec3 unproject(const Camera& camera, float x, float y, float depth_m) {
  const float scale = camera.role == CameraRole::Light ? 1.0F : depth_m;
  const glm::vec3 p{(x - camera.cx) / camera.fx * scale, (y - camera.cy) / camera.fy * scale, depth_m};
  return camera.world_from_camera * p;
}

}  // namespace splatbus
