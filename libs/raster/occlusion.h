#pragma once

#include <cstdint>
#include <vector>

#include "gaussians/camera.h"
#include "gaussians/light.h"
#include "gaussians/pages.h"

namespace splatbus::raster {

/// Behind which depth a picture shows nothing any more, tile by tile: what Rasterizer::occlusion() says of the last
/// forward(). The next picture of the same camera leaves out the pages that lie behind.
struct Occlusion {
  Camera camera;
  ObjectTransforms objects;  ///< of the picture's scene
  std::uint32_t tile_side = 0, tiles_x = 0, tiles_y = 0;
  std::vector<float> depth_m;  ///< [tiles_y][tiles_x] along z; infinite where something may show at any depth

  [[nodiscard]] bool holds_for(const Camera& other, const ObjectTransforms& other_objects) const {
    return camera == other && objects == other_objects;
  }
  /// Whether a page shows nowhere, as long as nothing in front of it has changed. Exact, and a hundredth of its depth
  /// more careful than that, for what changes a little. `pinhole`: of the camera.
  [[nodiscard]] bool hides(const FrustumCamera& pinhole, const math::Similarity& camera_from_page,
                           const PageBounds& bounds) const;
};

}  // namespace splatbus::raster
