#include "relight/visibility.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <glm/glm.hpp>
#include <glm/gtc/quaternion.hpp>

#include "relight/filter_kernel.h"
#include "relight/visibility_limits.h"

namespace splatbus::relight {

namespace {

constexpr std::size_t kGrain = 2048;

class Tester {
 public:
  Tester(const LightDepthMap& map, const VisibilityOptions& options)
      : map_(map),
        options_(options),
        width_(static_cast<int>(map.camera.width)),
        height_(static_cast<int>(map.camera.height)),
        light_from_world_(inverse(map.camera.world_from_camera)),
        rotation_(glm::mat3_cast(light_from_world_.rotation)) {}

  [[nodiscard]] float test(const glm::vec3& point_world, const glm::vec3& normal_world, float deviation_m) const {
    const glm::vec3 normal = rotation_ * normal_world;
    const float facing = -normal.z;
    if (!(facing > kLeastFacing)) return 0;
    const Camera& camera = map_.camera;
    const float texel_m = 1.0F / std::min(camera.fx, camera.fy);
    const glm::vec3 lifted = point_world + normal_world * (options_.lift_texels * texel_m);
    const glm::vec3 point = rotation_ * lifted + light_from_world_.translation;
    glm::vec2 slope = glm::vec2(normal.x, normal.y) / facing;
    const float steepness = glm::length(slope);
    if (steepness > kGreatestSlope) slope *= kGreatestSlope / steepness;

    const float radius_m = kParaboloidOverDisc * (options_.softness_m + options_.footprint * deviation_m);
    const FilterWindow window{.x = camera.fx * point.x + camera.cx,
                              .y = camera.fy * point.y + camera.cy,
                              .depth_m = point.z,
                              .slope_x = slope.x / camera.fx,
                              .slope_y = slope.y / camera.fy,
                              .radius_x = bounded_radius(radius_m * camera.fx),
                              .radius_y = bounded_radius(radius_m * camera.fy)};
    if (!std::isfinite(window.depth_m + window.x + window.y)) return 0;
    const bool apart = window.x + window.radius_x < 0 || window.y + window.radius_y < 0 ||
                       window.x - window.radius_x > static_cast<float>(width_) ||
                       window.y - window.radius_y > static_cast<float>(height_);
    return apart ? 1 : lit_share(window, map_.depth_m, width_, height_);
  }

 private:
  [[nodiscard]] static float bounded_radius(float texels) {
    return std::clamp(texels, kLeastRadius_texels, kGreatestRadius_texels);
  }

  const LightDepthMap map_;
  const VisibilityOptions options_;
  const int width_, height_;
  const Rigid light_from_world_;
  const glm::mat3 rotation_;
};

/// Mean of the two larger standard deviations: a flat Gaussian's extent on its surface.
float surface_deviation_m(const GaussiansView& gaussians, std::size_t i) {
  if (gaussians.parameters == nullptr) return 0;
  const auto log_scale = [&](int axis) { return gaussians.plane(ParameterLayout::kLogScale + axis)[i]; };
  const float a = log_scale(0), b = log_scale(1), c = log_scale(2);
  if (std::isnan(a + b + c)) return kGreatestDeviation_m;
  const float middle = std::max(std::min(a, b), std::min(std::max(a, b), c));
  const float mean = 0.5F * (std::exp(middle) + std::exp(std::max({a, b, c})));
  return std::min(mean, kGreatestDeviation_m);
}

}  // namespace

void compute_visibility(const GaussiansView& gaussians, const ObjectTransforms& objects, const LightDepthMap& map,
                        const VisibilityOptions& options, std::span<float> visibility) {
  const Tester tester(map, options);
  const auto vec = [&](const float* planes, std::size_t i) {
    return glm::vec3(planes[i], planes[gaussians.stride + i], planes[2 * gaussians.stride + i]);
  };
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, gaussians.count, kGrain), [&](const auto& block) {
    for (std::size_t i = block.begin(); i < block.end(); ++i) {
      glm::vec3 point = vec(gaussians.surface_point, i);
      glm::vec3 normal = vec(gaussians.normal, i);
      if (!objects.empty() && gaussians.object_id != nullptr) {
        if (const auto object = objects.find(gaussians.object_id[i]); object != objects.end()) {
          point = object->second * point;
          normal = object->second.rotation * normal;
        }
      }
      visibility[i] = tester.test(point, normal, surface_deviation_m(gaussians, i));
    }
  });
}

}  // namespace splatbus::relight
