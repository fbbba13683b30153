#pragma once

#include <cstdint>

#include "bus/parameters.h"
#include "gaussians/camera.h"

namespace splatbus::viewer {

/// The viewer's camera over time: it turns about the target once a period, or stays where the orbit begins.
struct CameraPath {
  std::uint32_t width = 256, height = 256;
  float fov_radians = 1.0471976F;  ///< vertical
  bool orbit = true;
  float radius_m = 4;  ///< from the target, level
  float height_m = 2;  ///< above the world's zero
  double period_s = 30;
  float phase_radians = 0;  ///< where the orbit begins, from +x towards +z
  glm::vec3 target_m{0, 0.4F, 0};

  void bind(bus::ParameterBinder& parameters);
  [[nodiscard]] Camera at(double seconds) const;
};

}  // namespace splatbus::viewer
