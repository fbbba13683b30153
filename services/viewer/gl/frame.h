#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <vector>

#include "gaussians/camera.h"
#include "gaussians/depth_order.h"
#include "viewer/gl/rows.h"

namespace splatbus::viewer::gl {

/// world_from_object, row-major [3][4]; all zero hides what is in it.
using Transform = DepthOrder::Transform;

/// What one picture shows of the rows.
struct Frame {
  Camera camera;
  std::vector<Transform> transforms;  ///< by the index that records have
  std::uint32_t far_field = 0;  ///< index of what goes with the eye, its transform for an eye in the origin; 0: none
  glm::vec3 background{0};      ///< linear
  bool display_space = false;   ///< colors are blended under the sRGB curve
  bool antialias = true;        ///< what is smaller than a pixel becomes as much fainter as it is made larger
  float resolution = 1;         ///< of the splats, of the picture's along each side; it is stretched over it
  float time_s = kSettled_s;    ///< by the clock of RowUpdate::fades
  float color_part = 1;         ///< from the colors that RowStore has kept to those that there are
};

}  // namespace splatbus::viewer::gl
