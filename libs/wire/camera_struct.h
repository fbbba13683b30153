#pragma once

#include "wire/common_generated.h"

namespace splatbus {

/// The wire's struct of a camera whose fields have its names, and that stands there.
template <class AnyCamera>
[[nodiscard]] wire::Camera camera_struct(const AnyCamera& camera, const wire::Rigid& world_from_camera) {
  return {camera.id,        static_cast<wire::CameraRole>(camera.role),
          camera.width,     camera.height,
          camera.fx,        camera.fy,
          camera.cx,        camera.cy,
          camera.near_m,    camera.far_m,
          world_from_camera};
}

}  // namespace splatbus
