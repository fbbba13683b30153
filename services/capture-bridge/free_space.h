#pragma once

#include <array>
#include <cstddef>
#include <glm/glm.hpp>
#include <vector>

#include "gaussians/camera.h"

namespace splatbus::capture_bridge {

/// Where nothing stands about a place, from depth pictures of the six faces of a cube there.
class FreeSpace {
 public:
  static constexpr std::size_t kFaces = 6;
  using Depth = std::array<std::vector<float>, kFaces>;

  /// The cameras of the faces, `size` pixels square. Neighbouring faces overlap by a pixel.
  [[nodiscard]] static std::array<Camera, kFaces> cameras(const glm::vec3& place, int size, float near_m, float far_m);

  /// What those cameras see: metres along each one's z, row-major, 0 where there is no surface.
  FreeSpace(const std::array<Camera, kFaces>& cameras, Depth depth_m)
      : cameras_(cameras), depth_m_(std::move(depth_m)) {}

  [[nodiscard]] const glm::vec3& place() const { return cameras_.front().world_from_camera.translation; }
  /// Metres to the nearest surface within a pixel of a direction, which is unit; infinite where there is none.
  [[nodiscard]] float distance(const glm::vec3& direction) const;
  /// Whether a point can be seen from the place.
  [[nodiscard]] bool sees(const glm::vec3& point) const;
  /// The point, or, where it is hidden or near a surface, one on the way to it: at four fifths of the free distance,
  /// less `clearance_m`.
  [[nodiscard]] glm::vec3 reachable(const glm::vec3& point, float clearance_m) const;

 private:
  std::array<Camera, kFaces> cameras_;
  Depth depth_m_;
};

}  // namespace splatbus::capture_bridge
