#include "relight/visibility.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/glm.hpp>
#include <glm/gtc/quaternion.hpp>
#include <limits>

#include "relight/visibility_limits.h"

namespace splatbus::relight {

namespace {

constexpr std::size_t kGrain = 2048;

/// The plane of a surface in texels across and metres of depth.
struct Receiver {
  glm::vec2 texel{0};
  float depth_m = 0;
  glm::vec2 slope{0};  ///< metres of depth a texel

  [[nodiscard]] float depth_at(float x, float y) const {
    return depth_m + slope.x * (x - texel.x) + slope.y * (y - texel.y);
  }
};

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

    const Receiver receiver{.texel = {camera.fx * point.x + camera.cx, camera.fy * point.y + camera.cy},
                            .depth_m = point.z,
                            .slope = {slope.x / camera.fx, slope.y / camera.fy}};
    if (!std::isfinite(receiver.depth_m + receiver.texel.x + receiver.texel.y)) return 0;
    const float radius_m = options_.softness_m + options_.footprint * deviation_m;
    const glm::vec2 radius = glm::clamp(kParaboloidOverDisc * radius_m * glm::vec2(camera.fx, camera.fy),
                                        kLeastRadius_texels, kGreatestRadius_texels);
    return filtered(receiver, radius);
  }

 private:
  struct Sum {
    std::array<float, kLanes> lit{}, weight{};
  };

  /// Share of lit texels about the receiver, weighted by 1 - (distance / radius)^2.
  [[nodiscard]] float filtered(const Receiver& receiver, const glm::vec2& radius) const {
    const glm::vec2 low = glm::floor(receiver.texel - radius);
    const glm::vec2 high = glm::ceil(receiver.texel + radius);
    const bool apart =
        high.x < 0 || high.y < 0 || low.x > static_cast<float>(width_) || low.y > static_cast<float>(height_);
    if (apart) return 1;
    const int left = static_cast<int>(low.x);
    const int right = left + (static_cast<int>(high.x) - left + kLanes - 1) / kLanes * kLanes;
    const int bottom = static_cast<int>(high.y);
    Sum sum;
    for (int y = static_cast<int>(low.y); y < bottom; ++y) {
      const bool within = y >= 0 && y < height_ && left >= 0 && right <= width_;
      for (int x = left; x < right; x += kLanes) {
        if (within) {
          add(receiver, radius, x, y, texels(x, y), sum);
        } else {
          add(receiver, radius, x, y, padded(x, y).data(), sum);
        }
      }
    }
    float lit = 0;
    float weight = 0;
    for (std::size_t k = 0; k < kLanes; ++k) {
      lit += sum.lit[k];
      weight += sum.weight[k];
    }
    return lit < weight ? lit / weight : 1.0F;
  }

  /// Texels (x, y) to (x + kLanes - 1, y). Written for the compiler to vectorise.
  static void add(const Receiver& receiver, const glm::vec2& radius, int x, int y, const float* depth_m, Sum& sum) {
    const float row_m = receiver.depth_at(static_cast<float>(x) + 0.5F, static_cast<float>(y) + 0.5F);
    const float dx = (static_cast<float>(x) + 0.5F - receiver.texel.x) / radius.x;
    const float dy = (static_cast<float>(y) + 0.5F - receiver.texel.y) / radius.y;
    const float step = 1.0F / radius.x;
    for (std::size_t k = 0; k < kLanes; ++k) {
      const float across = dx + static_cast<float>(k) * step;
      const float weight = std::max(0.0F, 1.0F - across * across - dy * dy);
      const float plane_m = row_m + static_cast<float>(k) * receiver.slope.x;
      sum.weight[k] += weight;
      sum.lit[k] += plane_m <= depth_m[k] ? weight : 0.0F;
    }
  }

  [[nodiscard]] const float* texels(int x, int y) const {
    return map_.depth_m + static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) + static_cast<std::size_t>(x);
  }

  /// A piece of a row that leaves the map: what lies outside is lit.
  [[nodiscard]] std::array<float, kLanes> padded(int x, int y) const {
    std::array<float, kLanes> depth_m{};
    for (int k = 0; k < kLanes; ++k) {
      const bool inside = x + k >= 0 && x + k < width_ && y >= 0 && y < height_;
      depth_m.at(static_cast<std::size_t>(k)) = inside ? *texels(x + k, y) : std::numeric_limits<float>::max();
    }
    return depth_m;
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
