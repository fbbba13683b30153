#include "capture-bridge/free_space.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace splatbus::capture_bridge {

namespace {

constexpr float kReach = 0.8F;  // of the free distance: what stands at the side of the ray is farther away then

}  // namespace

std::array<Camera, FreeSpace::kFaces> FreeSpace::cameras(const glm::vec3& place, int size, float near_m, float far_m) {
  std::array<Camera, kFaces> cameras;
  const auto pixels = static_cast<std::uint32_t>(size);
  const float fov_radians = 2 * std::atan(static_cast<float>(size) / static_cast<float>(size - 2));
  for (std::size_t face = 0; face < kFaces; ++face) {
    glm::vec3 axis(0);
    axis[static_cast<glm::length_t>(face / 2)] = face % 2 == 0 ? 1.0F : -1.0F;
    Camera& camera = cameras.at(face) = look_at(place, place + axis, pixels, pixels, fov_radians);
    camera.world_from_camera.translation = place;
    camera.role = CameraRole::Probe;
    camera.near_m = near_m;
    camera.far_m = far_m;
  }
  return cameras;
}

float FreeSpace::distance(const glm::vec3& direction) const {
  const auto facing = [&](const Camera& camera) {
    return glm::dot(camera.world_from_camera.rotation * glm::vec3(0, 0, 1), direction);
  };
  const auto face = static_cast<std::size_t>(std::ranges::max_element(cameras_, {}, facing) - cameras_.begin());
  const Camera& camera = cameras_.at(face);
  const glm::vec3 at = project(camera, place() + direction);
  const auto width = static_cast<int>(camera.width), height = static_cast<int>(camera.height);
  const int column = static_cast<int>(at.x), row = static_cast<int>(at.y);
  float nearest = std::numeric_limits<float>::infinity();
  for (int y = std::max(0, row - 1); y <= std::min(height - 1, row + 1); ++y) {
    for (int x = std::max(0, column - 1); x <= std::min(width - 1, column + 1); ++x) {
      const float depth_m = depth_m_.at(face)[static_cast<std::size_t>(y) * camera.width + static_cast<std::size_t>(x)];
      if (!(depth_m > 0)) continue;
      const glm::vec3 ray((static_cast<float>(x) + 0.5F - camera.cx) / camera.fx,
                          (static_cast<float>(y) + 0.5F - camera.cy) / camera.fy, 1);
      nearest = std::min(nearest, depth_m * glm::length(ray));
    }
  }
  return nearest;
}

bool FreeSpace::sees(const glm::vec3& point) const {
  const float metres = glm::distance(point, place());
  return metres == 0 || metres < distance((point - place()) / metres);
}

glm::vec3 FreeSpace::reachable(const glm::vec3& point, float clearance_m) const {
  const float metres = glm::distance(point, place());
  if (metres == 0) return point;
  const glm::vec3 direction = (point - place()) / metres;
  const float most_m = std::max(0.0F, kReach * distance(direction) - clearance_m);
  return metres <= most_m ? point : place() + most_m * direction;
}

}  // namespace splatbus::capture_bridge
