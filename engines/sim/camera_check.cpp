#include "sim/camera_check.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <span>

#include "wire/picture_size.h"

namespace splatbus::sim {

std::string camera_problem(const splatbus_camera& camera) {
  const auto named = [&](const std::string& what) {
    return fmt::format("camera {} (role {}): {}", camera.id, camera.role, what);
  };
  // What is rendered here has several buffers; a depth map has one.
  const bool fits = camera.role == SPLATBUS_ROLE_LIGHT ? is_picture_size(camera.width, camera.height)
                                                       : is_probe_size(camera.width, camera.height);
  if (!fits) {
    return named(fmt::format("a picture of {} x {} is out of bounds (1 to {} a side, at most {} pixels)", camera.width,
                             camera.height, kMaxPictureSide, kMaxProbePixels));
  }
  const auto finite = [](std::span<const float> values) {
    return std::ranges::all_of(values, [](float value) { return std::isfinite(value); });
  };
  const std::array<float, 6> lens{camera.fx, camera.fy, camera.cx, camera.cy, camera.near_m, camera.far_m};
  if (!finite(lens) || camera.fx <= 0 || camera.fy <= 0)
    return named("fx, fy, cx, cy must be finite, fx and fy above 0");
  if (camera.near_m <= 0 || camera.far_m <= camera.near_m) return named("it must be 0 < near_m < far_m");
  const splatbus_rigid& pose = camera.world_from_camera;
  if (!finite(pose.rotation_wxyz) || !finite(pose.translation)) return named("its pose is not finite");
  float norm = 0;
  for (const float q : pose.rotation_wxyz) norm += q * q;
  if (std::abs(norm - 1) > 1e-2F)
    return named(fmt::format("rotation is not a unit quaternion (norm {:.3f})", std::sqrt(norm)));
  return {};
}

}  // namespace splatbus::sim
