#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <glm/gtc/quaternion.hpp>

namespace splatbus {

/// a_from_b: p_a = rotation * p_b + translation. `rotation` is unit.
struct Rigid {
  glm::quat rotation{1, 0, 0, 0};  // w x y z
  glm::vec3 translation{0};
  bool operator==(const Rigid&) const = default;
};

[[nodiscard]] Rigid inverse(const Rigid& a_from_b);
[[nodiscard]] Rigid operator*(const Rigid& a_from_b, const Rigid& b_from_c);
[[nodiscard]] glm::vec3 operator*(const Rigid& a_from_b, const glm::vec3& point_b);

enum class CameraRole : std::uint8_t { Input, Reference, Probe, Light };

/// Pinhole, x right, y down, z forward, pixel centres at +0.5. Role Light: orthographic, fx and fy in pixels a metre.
struct Camera {
  std::uint32_t id = 0;
  CameraRole role = CameraRole::Reference;
  std::uint32_t width = 0, height = 0;
  float fx = 0, fy = 0, cx = 0, cy = 0;  // pixels
  float near_m = 0.05F, far_m = 100.0F;
  Rigid world_from_camera;
  bool operator==(const Camera&) const = default;
};

/// A camera at `eye` that looks at `target`, world y up, square pixels, principal point in the middle.
[[nodiscard]] Camera look_at(const glm::vec3& eye, const glm::vec3& target, std::uint32_t width, std::uint32_t height,
                             float vertical_fov_radians);

/// Pixel coordinates and depth along z, without a check that the depth is positive.
[[nodiscard]] glm::vec3 project(const Camera& camera, const glm::vec3& point_world);
/// The world point at pixel coordinates (x, y) and depth z.
[[nodiscard]] glm::vec3 unproject(const Camera& camera, float x, float y, float depth_m);

}  // namespace splatbus
