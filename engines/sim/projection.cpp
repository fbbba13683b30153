#include "sim/projection.h"

#include <algorithm>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <glm/gtc/matrix_access.hpp>
#include <glm/gtc/quaternion.hpp>

namespace splatbus::sim {
namespace {

/// The greatest value of dot(plane, p) in the box.
float greatest(const glm::vec4& plane, const Bounds& box) {
  const glm::vec3 normal(plane);
  const glm::vec3 most = glm::max(normal * box.low, normal * box.high);
  return plane.w + most.x + most.y + most.z;
}

}  // namespace

Projection projection_by_role(const splatbus_camera& camera) {
  return camera.role == SPLATBUS_ROLE_LIGHT ? Projection::Orthographic : Projection::Pinhole;
}

void set_pose(splatbus_camera& camera, const glm::mat3& world_from_camera, const glm::vec3& eye) {
  const glm::quat rotation = glm::normalize(glm::quat_cast(world_from_camera));
  float* wxyz = camera.world_from_camera.rotation_wxyz;
  wxyz[0] = rotation.w;
  wxyz[1] = rotation.x;
  wxyz[2] = rotation.y;
  wxyz[3] = rotation.z;
  for (int i = 0; i < 3; ++i) camera.world_from_camera.translation[i] = eye[i];
}

glm::mat4 camera_from_world(const splatbus_camera& camera) {
  const float* q = camera.world_from_camera.rotation_wxyz;
  const float* t = camera.world_from_camera.translation;
  const glm::mat3 rotation = glm::transpose(glm::mat3_cast(glm::normalize(glm::quat(q[0], q[1], q[2], q[3]))));
  glm::mat4 result(rotation);
  result[3] = glm::vec4(-(rotation * glm::vec3(t[0], t[1], t[2])), 1);
  return result;
}

glm::mat4 clip_from_camera(const splatbus_camera& camera, Projection projection) {
  const auto width = static_cast<float>(camera.width);
  const auto height = static_cast<float>(camera.height);
  const float near_m = camera.near_m;
  const float far_m = camera.far_m;
  glm::mat4 clip(0);
  clip[0][0] = 2 * camera.fx / width;
  clip[1][1] = 2 * camera.fy / height;
  const float x = 2 * camera.cx / width - 1;
  const float y = 2 * camera.cy / height - 1;
  if (projection == Projection::Orthographic) {
    clip[2][2] = 2 / (far_m - near_m);
    clip[3] = {x, y, -(far_m + near_m) / (far_m - near_m), 1};
  } else {
    clip[2] = {x, y, (far_m + near_m) / (far_m - near_m), 1};
    clip[3][2] = -2 * far_m * near_m / (far_m - near_m);
  }
  return clip;
}

splatbus_camera look_at(const glm::vec3& eye, const glm::vec3& target, std::uint32_t width, std::uint32_t height,
                        float vertical_fov_deg) {
  const glm::vec3 forward = glm::normalize(target - eye);
  const glm::vec3 up = std::abs(forward.y) > 0.999F ? glm::vec3{0, 0, 1} : glm::vec3{0, 1, 0};
  const glm::vec3 right = glm::normalize(glm::cross(forward, up));
  splatbus_camera camera{};
  camera.role = SPLATBUS_ROLE_REFERENCE;
  camera.width = width;
  camera.height = height;
  camera.fy = static_cast<float>(height) / 2 / std::tan(glm::radians(vertical_fov_deg) / 2);
  camera.fx = camera.fy;
  camera.cx = static_cast<float>(width) / 2;
  camera.cy = static_cast<float>(height) / 2;
  camera.near_m = 0.05F;
  camera.far_m = 100;
  set_pose(camera, glm::mat3(right, glm::cross(forward, right), forward), eye);
  return camera;
}

splatbus_camera fit_camera(const Bounds& bounds, std::uint32_t width, std::uint32_t height, float vertical_fov_deg) {
  constexpr float kMargin = 1.03F;
  const glm::vec3 middle = (bounds.low + bounds.high) / 2.0F, from = glm::normalize(glm::vec3(0.62F, 0.48F, 0.62F));
  splatbus_camera camera = look_at(middle + from, middle, width, height, vertical_fov_deg);
  const glm::mat3 camera_from_axes(camera_from_world(camera));
  const float across = camera.cx / camera.fx, down = camera.cy / camera.fy;
  float away = 1e-3F;
  for (int i = 0; i < 8; ++i) {
    const glm::vec3 p = camera_from_axes * (bounds.corner(i) - middle);
    away = std::max({away, kMargin * std::abs(p.x) / across - p.z, kMargin * std::abs(p.y) / down - p.z});
  }
  camera = look_at(middle + away * from, middle, width, height, vertical_fov_deg);
  camera.near_m = std::min(camera.near_m, away / 100);
  reach(camera, bounds);
  return camera;
}

void reach(splatbus_camera& camera, const Bounds& bounds) {
  const glm::mat4 from_world = camera_from_world(camera);
  for (int i = 0; i < 8 && !bounds.empty(); ++i) {
    camera.far_m = std::max(camera.far_m, 1.01F * (from_world * glm::vec4(bounds.corner(i), 1)).z);
  }
}

splatbus_camera fit_light_camera(const Bounds& bounds, const glm::vec3& sun_direction, std::uint32_t width,
                                 std::uint32_t height) {
  constexpr int kRolls = 45;
  constexpr float kMargin = 1.02F;
  constexpr float kDepthMargin_m = 0.5F;
  const glm::vec3 forward = -glm::normalize(sun_direction);
  const glm::vec3 helper = std::abs(forward.y) > 0.9F ? glm::vec3{1, 0, 0} : glm::vec3{0, 1, 0};
  const glm::vec3 first = glm::normalize(glm::cross(forward, helper));
  const glm::vec3 second = glm::cross(forward, first);
  const float aspect = static_cast<float>(width) / static_cast<float>(height);

  splatbus_camera best{};
  float best_size = 1e30F;
  for (int i = 0; i < kRolls; ++i) {
    const float angle = glm::pi<float>() * static_cast<float>(i) / kRolls;
    const glm::vec3 right = first * std::cos(angle) + second * std::sin(angle);
    const glm::mat3 world_from_light(right, glm::cross(forward, right), forward);
    Bounds fitted;
    for (int corner = 0; corner < 8; ++corner) fitted.add(glm::transpose(world_from_light) * bounds.corner(corner));
    const glm::vec3 extent = glm::max((fitted.high - fitted.low) * kMargin, glm::vec3(1e-3F));
    const float size = std::max(extent.x, extent.y * aspect);
    if (size >= best_size) continue;
    best_size = size;
    best.role = SPLATBUS_ROLE_LIGHT;
    best.width = width;
    best.height = height;
    best.fx = static_cast<float>(width) / extent.x;
    best.fy = static_cast<float>(height) / extent.y;
    best.cx = static_cast<float>(width) / 2;
    best.cy = static_cast<float>(height) / 2;
    best.near_m = kDepthMargin_m / 2;
    best.far_m = extent.z + 1.5F * kDepthMargin_m;
    const glm::vec3 middle = (fitted.low + fitted.high) / 2.0F;
    set_pose(best, world_from_light, world_from_light * glm::vec3(middle.x, middle.y, fitted.low.z - kDepthMargin_m));
  }
  return best;
}

Frustum::Frustum(const glm::mat4& clip_from_world) : w_(glm::row(clip_from_world, 3)) {
  for (int axis = 0; axis < 3; ++axis) {
    const glm::vec4 along = glm::row(clip_from_world, axis);
    planes_.at(2 * static_cast<std::size_t>(axis)) = w_ + along;
    planes_.at(2 * static_cast<std::size_t>(axis) + 1) = w_ - along;
  }
}

bool Frustum::may_show(const Bounds& box_world) const {
  return std::ranges::none_of(planes_, [&](const glm::vec4& plane) { return greatest(plane, box_world) < 0; });
}

float Frustum::farthest(const Bounds& box_world) const {
  return greatest(w_, box_world);
}

}  // namespace splatbus::sim
