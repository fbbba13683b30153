#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "gaussians/camera.h"

namespace splatbus::viewer {

/// The same view in a picture of `factor` times as many pixels along each side, 8 at least.
[[nodiscard]] inline Camera scaled(const Camera& camera, float factor) {
  if (factor == 1) return camera;
  Camera out = camera;
  const auto side = [factor](std::uint32_t pixels) {
    return std::max(8U, static_cast<std::uint32_t>(std::lround(factor * static_cast<float>(pixels))));
  };
  out.width = side(camera.width);
  out.height = side(camera.height);
  const float across = static_cast<float>(out.width) / static_cast<float>(camera.width);
  const float down = static_cast<float>(out.height) / static_cast<float>(camera.height);
  out.fx *= across;
  out.cx *= across;
  out.fy *= down;
  out.cy *= down;
  return out;
}

}  // namespace splatbus::viewer
