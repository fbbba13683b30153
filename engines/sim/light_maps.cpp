#include "sim/light_maps.h"

#include <algorithm>
#include <cmath>
#include <span>

namespace splatbus::sim {
namespace {

struct Axes {
  glm::vec3 right, down, forward;
};

/// That look along `forward`. They depend on it alone.
Axes axes_along(const glm::vec3& forward) {
  const glm::vec3 helper = std::abs(forward.y) > 0.9F ? glm::vec3{1, 0, 0} : glm::vec3{0, 1, 0};
  const glm::vec3 right = glm::normalize(glm::cross(forward, helper));
  return {right, glm::cross(forward, right), forward};
}

splatbus_camera sized(std::uint32_t width, std::uint32_t height) {
  splatbus_camera camera{};
  camera.role = SPLATBUS_ROLE_LIGHT;
  camera.width = width;
  camera.height = height;
  camera.cx = static_cast<float>(width) / 2;
  camera.cy = static_cast<float>(height) / 2;
  return camera;
}

/// Pixels from the middle to where `tangent` is seen, with a margin beyond it.
float focal_length(float middle_px, float tangent) {
  constexpr float kMargin_px = 2;
  return (middle_px - std::min(kMargin_px, middle_px / 4)) / tangent;
}

splatbus_camera pinhole_at(const splatbus_light_source& source, const Axes& axes, float tangent, std::uint32_t width,
                           std::uint32_t height) {
  constexpr float kNearest_m = 0.02F;
  splatbus_camera camera = sized(width, height);
  camera.fx = focal_length(camera.cx, tangent);
  camera.fy = focal_length(camera.cy, tangent);
  camera.near_m = std::min(kNearest_m, source.range_m / 10);
  camera.far_m = source.range_m;
  const float* eye = source.position;
  set_pose(camera, glm::mat3(axes.right, axes.down, axes.forward), {eye[0], eye[1], eye[2]});
  return camera;
}

}  // namespace

splatbus_camera cascade_camera(const glm::vec3& centre, float extent_m, const glm::vec3& to_light, const Bounds& scene,
                               std::uint32_t width, std::uint32_t height, float step_texels) {
  constexpr float kMargin_m = 0.5F;
  const Axes axes = axes_along(-glm::normalize(to_light));
  splatbus_camera camera = sized(width, height);
  camera.fx = static_cast<float>(width) / extent_m;
  camera.fy = static_cast<float>(height) / extent_m;
  float low = 0, high = 0;
  for (int i = 0; i < 8 && !scene.empty(); ++i) {
    const float z = glm::dot(scene.corner(i), axes.forward);
    low = i == 0 ? z : std::min(low, z);
    high = i == 0 ? z : std::max(high, z);
  }
  camera.near_m = kMargin_m / 2;
  camera.far_m = high - low + 1.5F * kMargin_m;
  const auto snapped = [&](float at_m, float px_a_m) {
    const float step_m = step_texels / px_a_m;
    return std::round(at_m / step_m) * step_m;
  };
  set_pose(camera, glm::mat3(axes.right, axes.down, axes.forward),
           snapped(glm::dot(centre, axes.right), camera.fx) * axes.right +
               snapped(glm::dot(centre, axes.down), camera.fy) * axes.down + (low - kMargin_m) * axes.forward);
  return camera;
}

splatbus_camera point_face_camera(const splatbus_light_source& source, std::uint32_t face, std::uint32_t width,
                                  std::uint32_t height) {
  glm::vec3 forward(0);
  forward[static_cast<int>(face / 2)] = face % 2 == 0 ? 1.0F : -1.0F;
  return pinhole_at(source, axes_along(forward), 1, width, height);
}

splatbus_camera spot_camera(const splatbus_light_source& source, std::uint32_t width, std::uint32_t height) {
  constexpr float kWidest_deg = 80;
  const float half = std::min(std::acos(source.cos_outer), glm::radians(kWidest_deg));
  const float* axis = source.direction;
  return pinhole_at(source, axes_along(glm::normalize(glm::vec3(axis[0], axis[1], axis[2]))), std::tan(half), width,
                    height);
}

std::optional<LightCamera> light_camera(const splatbus_camera_request& request, const LitScene& scene) {
  const std::uint32_t width = request.camera.width, height = request.camera.height;
  const auto named = [&](splatbus_camera camera, Projection projection) {
    camera.id = request.camera.id;
    return LightCamera{camera, projection};
  };
  const auto along = [&](const float(&to_light)[3]) {
    const glm::vec3 direction{to_light[0], to_light[1], to_light[2]};
    const float* centre = request.camera.world_from_camera.translation;
    return named(request.extent_m > 0 ? cascade_camera({centre[0], centre[1], centre[2]}, request.extent_m, direction,
                                                       scene.bounds, width, height)
                                      : fit_light_camera(scene.bounds, direction, width, height),
                 Projection::Orthographic);
  };
  if (request.light_id == 0) return along(scene.light.sun_direction);
  const std::span sources(scene.light.sources, scene.light.source_count);
  const auto source = std::ranges::find(sources, request.light_id, &splatbus_light_source::id);
  if (source == sources.end() || source->casts_shadow == 0) return std::nullopt;
  if (source->kind == SPLATBUS_LIGHT_DIRECTIONAL) return along(source->direction);
  if (source->kind == SPLATBUS_LIGHT_POINT && request.light_map < 6)
    return named(point_face_camera(*source, request.light_map, width, height), Projection::Pinhole);
  if (source->kind == SPLATBUS_LIGHT_SPOT && request.light_map == 0)
    return named(spot_camera(*source, width, height), Projection::Pinhole);
  return std::nullopt;
}

}  // namespace splatbus::sim
