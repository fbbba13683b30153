#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <glm/glm.hpp>
#include <optional>
#include <vector>

#include "capture-bridge/input_view.h"
#include "capture-bridge/rig.h"

namespace splatbus::capture_bridge::test {

/// A floor of 5 m x 5 m at y = 0 (object 1), a ball of 0.5 m on it (object 2) and a thin upright sheet (object 3), cast
/// by rays: exact positions and normals to check the pipeline against.
struct AnalyticScene {
  static constexpr float kFloorHalf = 2.5F;
  static constexpr std::uint32_t kFloor = 1, kBall = 2, kSheet = 3, kBox = 4;
  std::uint32_t first_object_id = 0;  ///< added to the objects' numbers
  glm::vec3 ball_centre{0.6F, 0.5F, 0.1F};
  float ball_radius = 0.5F;
  glm::vec3 sheet_centre{-0.9F, 0.6F, -0.2F};  // in the plane z = const, seen from both sides
  float sheet_half = 0.5F;
  /// Solid, with sides along the axes (object 4).
  struct Box {
    glm::vec3 low, high;
    [[nodiscard]] bool holds(const glm::vec3& point) const {
      return glm::all(glm::greaterThan(point, low)) && glm::all(glm::lessThan(point, high));
    }
  };
  std::vector<Box> boxes;

  struct Hit {
    float distance;
    glm::vec3 position, normal;
    std::uint32_t object;
  };

  [[nodiscard]] std::optional<Hit> cast(const glm::vec3& origin, const glm::vec3& direction) const {
    std::optional<Hit> nearest;
    const auto take = [&](float distance, const glm::vec3& normal, std::uint32_t object) {
      if (distance <= 1e-4F || (nearest && nearest->distance <= distance)) return;
      nearest = Hit{distance, origin + distance * direction, normal, object};
    };
    const float floor = -origin.y / direction.y;
    const glm::vec3 on_floor = origin + floor * direction;
    if (std::abs(on_floor.x) < kFloorHalf && std::abs(on_floor.z) < kFloorHalf) take(floor, {0, 1, 0}, kFloor);
    const float along = glm::dot(ball_centre - origin, direction);
    const glm::vec3 closest = origin + along * direction - ball_centre;
    const float inside = ball_radius * ball_radius - glm::dot(closest, closest);
    if (inside > 0) {
      const float distance = along - std::sqrt(inside);
      take(distance, glm::normalize(origin + distance * direction - ball_centre), kBall);
    }
    const float sheet = (sheet_centre.z - origin.z) / direction.z;
    const glm::vec3 on_sheet = origin + sheet * direction - sheet_centre;
    if (std::abs(on_sheet.x) < sheet_half && std::abs(on_sheet.y) < sheet_half) {
      take(sheet, {0, 0, direction.z > 0 ? -1.0F : 1.0F}, kSheet);
    }
    for (const Box& box : boxes) {
      const glm::vec3 a = (box.low - origin) / direction, b = (box.high - origin) / direction;
      const glm::vec3 enters = glm::min(a, b), leaves = glm::max(a, b);
      const float enter = std::max({enters.x, enters.y, enters.z}), leave = std::min({leaves.x, leaves.y, leaves.z});
      if (enter > leave || leave < 0) continue;
      const float side = enter > 1e-4F ? enter : leave;  // who is inside sees the far side
      const glm::vec3 normal = enter > 1e-4F ? -glm::vec3(glm::equal(enters, glm::vec3(enter))) * glm::sign(direction)
                                             : -glm::vec3(glm::equal(leaves, glm::vec3(leave))) * glm::sign(direction);
      take(side, normal, kBox);
    }
    return nearest;
  }

  [[nodiscard]] InputView render(const Camera& camera) const {
    InputView view;
    view.camera = camera;
    bus::MemoryPool own(Device::Cpu);  // so that views share nothing
    view.allocate(own);
    std::size_t i = 0;
    for (std::uint32_t y = 0; y < camera.height; ++y) {
      for (std::uint32_t x = 0; x < camera.width; ++x, ++i) {
        const glm::vec3 origin = camera.world_from_camera.translation;
        const glm::vec3 through = unproject(camera, static_cast<float>(x) + 0.5F, static_cast<float>(y) + 0.5F, 1);
        const auto hit = cast(origin, glm::normalize(through - origin));
        view.position[i] = hit ? glm::vec4(hit->position, 0) : glm::vec4(0);
        view.object_id[i] = hit ? first_object_id + hit->object : 0;
        view.normal[i] = hit ? glm::vec4(hit->normal, 0) : glm::vec4(0);
        view.color[i] = hit ? Rgba8{128, 64, 32, 255} : Rgba8{0, 0, 0, 0};
        view.albedo[i] = hit ? Rgba8{200, 100, 50, 255} : Rgba8{0, 0, 0, 0};
      }
    }
    return view;
  }

  [[nodiscard]] std::vector<InputView> render_all(const std::vector<Camera>& cameras) const {
    std::vector<InputView> views;
    for (const Camera& camera : cameras) views.push_back(render(camera));
    return views;
  }
};

/// Walls of 0.2 m and a ceiling about a room of 4 m x 4 m that is 2.6 m high, whose middle is there on the floor. In
/// its wall towards +x is a door, 0.9 m wide, that is closed or open.
inline std::vector<AnalyticScene::Box> room(const glm::vec3& middle, bool open_door) {
  std::vector<AnalyticScene::Box> boxes{
      {{-2.2F, 0, -2.2F}, {2.2F, 2.8F, -2}},   {{-2.2F, 0, 2}, {2.2F, 2.8F, 2.2F}},
      {{-2.2F, 0, -2}, {-2, 2.8F, 2}},         {{2, 0, -2}, {2.2F, 2.8F, -0.45F}},
      {{2, 0, 0.45F}, {2.2F, 2.8F, 2}},        {{-2.2F, 2.6F, -2.2F}, {2.2F, 2.8F, 2.2F}},
      {{2, 2.1F, -0.45F}, {2.2F, 2.8F, 0.45F}}};
  if (!open_door) boxes.push_back({{2, 0, -0.45F}, {2.2F, 2.1F, 0.45F}});
  for (AnalyticScene::Box& box : boxes) {
    box.low += middle;
    box.high += middle;
  }
  return boxes;
}

inline std::vector<Camera> small_dome(int cameras = 12, int size = 64) {
  return dome_cameras({.cameras = cameras, .size = size}, {0, 0.25F, 0}, 0);
}

}  // namespace splatbus::capture_bridge::test
