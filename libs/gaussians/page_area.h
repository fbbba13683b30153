#pragma once

#include <optional>

#include "gaussians/camera.h"
#include "gaussians/light.h"
#include "gaussians/pages.h"

namespace splatbus {

/// World frame, metres.
struct BoundingSphere {
  glm::vec3 centre;
  float radius;
};

/// About a page's Gaussians, which are of that object; nullopt for a page without any, and for an object that is not
/// there.
[[nodiscard]] std::optional<BoundingSphere> bounding_sphere(const PageBounds& bounds, std::uint32_t object_id,
                                                            const ObjectTransforms& objects);

/// The sphere's part of a camera's picture, pixels, at most all of them; nullopt where it does not show.
[[nodiscard]] std::optional<float> picture_area_px2(const Camera& camera, const BoundingSphere& sphere);

}  // namespace splatbus
