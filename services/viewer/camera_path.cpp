#include "viewer/camera_path.h"

#include <cmath>
#include <glm/gtc/constants.hpp>

namespace splatbus::viewer {

void CameraPath::bind(bus::ParameterBinder& p) {
  using bus::kDegrees;
  using bus::kRuntime;
  p.add("width", width, "pixels", {8, 8192});
  p.add("height", height, "pixels", {8, 8192});
  p.add("fov_degrees", fov_radians, "vertical field of view, degrees", {5, 150}, kRuntime, kDegrees);
  p.add("path", orbit, "of the camera, when there is no window to steer it", {{"orbit", true}, {"still", false}});
  p.add("radius_m", radius_m, "metres from the target, level", {0.01, 1e4});
  p.add("height_m", height_m, "metres above the world's zero", {-1e4, 1e4});
  p.add("period_s", period_s, "seconds a turn", {0.1, 1e6});
  p.add("phase_degrees", phase_radians, "where the orbit begins, from +x towards +z", {-360, 360}, kRuntime, kDegrees);
  p.add("target_x_m", target_m.x, "metres, what the camera looks at", {-1e4, 1e4});
  p.add("target_y_m", target_m.y, "metres", {-1e4, 1e4});
  p.add("target_z_m", target_m.z, "metres", {-1e4, 1e4});
}

Camera CameraPath::at(double seconds) const {
  const double turns = orbit ? seconds / period_s : 0;
  const float angle = phase_radians + glm::two_pi<float>() * static_cast<float>(std::fmod(turns, 1.0));
  const glm::vec3 eye(target_m.x + radius_m * std::cos(angle), height_m, target_m.z + radius_m * std::sin(angle));
  return look_at(eye, target_m, width, height, fov_radians);
}

}  // namespace splatbus::viewer
