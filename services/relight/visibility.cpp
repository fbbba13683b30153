#include "relight/visibility.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/glm.hpp>
#include <glm/gtc/matrix_transform.hpp>
#include <glm/gtc/quaternion.hpp>
#include <numbers>

namespace splatbus::relight {

namespace {

constexpr int kTaps = 16;
constexpr float kGreatestSlope = 8.0F;       // metres of depth a metre across: beyond it the normal is no guide
constexpr float kLeastFacing = 0.02F;        // cosine below which no light arrives
constexpr float kLeastRadius_texels = 1.0F;  // the map's own resolution
constexpr std::size_t kGrain = 2048;

/// Points spread evenly over the unit disc (Vogel 1979).
std::array<glm::vec2, kTaps> disc() {
  std::array<glm::vec2, kTaps> points{};
  const float golden_angle = std::numbers::pi_v<float> * (3.0F - std::sqrt(5.0F));
  for (int i = 0; i < kTaps; ++i) {
    const float radius = std::sqrt((static_cast<float>(i) + 0.5F) / kTaps);
    const float angle = golden_angle * static_cast<float>(i);
    points.at(static_cast<std::size_t>(i)) = radius * glm::vec2(std::cos(angle), std::sin(angle));
  }
  return points;
}

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
        rotation_(glm::mat3_cast(light_from_world_.rotation)),
        disc_(disc()) {}

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
    const glm::vec2 radius = glm::max(radius_m * glm::vec2(camera.fx, camera.fy), glm::vec2(kLeastRadius_texels));
    float sum = 0;
    for (const glm::vec2& tap : disc_) sum += filtered(receiver, receiver.texel + radius * tap);
    return sum / kTaps;
  }

 private:
  /// Bilinear mean of four comparisons about texel coordinates (x, y).
  [[nodiscard]] float filtered(const Receiver& receiver, const glm::vec2& at) const {
    const float left = std::floor(at.x - 0.5F);
    const float top = std::floor(at.y - 0.5F);
    if (left < -1 || top < -1 || left >= static_cast<float>(width_) || top >= static_cast<float>(height_)) return 1;
    const float fx = at.x - 0.5F - left;
    const float fy = at.y - 0.5F - top;
    const int x = static_cast<int>(left);
    const int y = static_cast<int>(top);
    const float upper = (1 - fx) * lit(receiver, x, y) + fx * lit(receiver, x + 1, y);
    const float lower = (1 - fx) * lit(receiver, x, y + 1) + fx * lit(receiver, x + 1, y + 1);
    return (1 - fy) * upper + fy * lower;
  }

  [[nodiscard]] float lit(const Receiver& receiver, int x, int y) const {
    if (x < 0 || y < 0 || x >= width_ || y >= height_) return 1;
    const float nearest =
        map_.depth_m[static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) + static_cast<std::size_t>(x)];
    return receiver.depth_at(static_cast<float>(x) + 0.5F, static_cast<float>(y) + 0.5F) <= nearest ? 1.0F : 0.0F;
  }

  const LightDepthMap map_;
  const VisibilityOptions options_;
  const int width_, height_;
  const Rigid light_from_world_;
  const glm::mat3 rotation_;
  const std::array<glm::vec2, kTaps> disc_;
};

/// Mean of the two larger standard deviations: a flat Gaussian's extent on its surface.
float surface_deviation_m(const GaussiansView& gaussians, std::size_t i) {
  if (gaussians.parameters == nullptr) return 0;
  std::array<float, 3> log_scale{};
  for (int axis = 0; axis < 3; ++axis) {
    log_scale.at(static_cast<std::size_t>(axis)) = gaussians.plane(ParameterLayout::kLogScale + axis)[i];
  }
  std::sort(log_scale.begin(), log_scale.end());
  const float mean = 0.5F * (std::exp(log_scale[1]) + std::exp(log_scale[2]));
  return mean < 1.0F ? mean : 1.0F;  // also when it is NaN
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
