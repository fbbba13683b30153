#include "gaussians/page_area.h"

#include <algorithm>
#include <numbers>

namespace splatbus {

std::optional<BoundingSphere> bounding_sphere(const PageBounds& bounds, std::uint32_t object_id,
                                              const ObjectTransforms& objects) {
  const math::Vec3 &low = bounds.low, &high = bounds.high;
  if (!(low.x <= high.x)) return std::nullopt;
  const glm::vec3 a(low.x, low.y, low.z), b(high.x, high.y, high.z);
  const BoundingSphere sphere{0.5F * (a + b), 0.5F * glm::length(b - a) + bounds.max_scale_m};
  if (object_id == kWorldFrame) return sphere;
  const auto object = objects.find(object_id);
  if (object == objects.end()) return std::nullopt;
  return BoundingSphere{object->second * sphere.centre, sphere.radius * object->second.scale};
}

std::optional<float> picture_area_px2(const Camera& camera, const BoundingSphere& sphere) {
  const glm::vec3 p = inverse(camera.world_from_camera) * sphere.centre;
  const auto width = static_cast<float>(camera.width), height = static_cast<float>(camera.height);
  if (glm::length(p) <= sphere.radius) return width * height;
  const float depth = std::max(p.z, camera.near_m);
  const float radius_px = sphere.radius * std::max(camera.fx, camera.fy) / depth;
  const float x = camera.fx * p.x / depth + camera.cx, y = camera.fy * p.y / depth + camera.cy;
  const bool shows =
      p.z > -sphere.radius && x > -radius_px && y > -radius_px && x < width + radius_px && y < height + radius_px;
  if (!shows) return std::nullopt;
  return std::min(std::numbers::pi_v<float> * radius_px * radius_px, width * height);
}

}  // namespace splatbus
