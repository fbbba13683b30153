#include "sim/sun_shadow.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/gtc/matrix_inverse.hpp>
#include <glm/gtc/matrix_transform.hpp>
#include <glm/gtc/type_ptr.hpp>

#include "sim/projection.h"

namespace splatbus::sim {
namespace {

constexpr float kFinestTexel_m = 0.012F;  // of the first cascade
constexpr float kCascadeRatio = 4;        // of a cascade's texels to those of the one before
constexpr float kWidestTexel_m = 0.025F;  // of a map that is alone
/// Of a cascade's width: what it moves by. The cameras that follow one viewer then share a map, and a walk draws it
/// anew every 6 m. It reaches at least three eighths of its width from an eye.
constexpr float kStep = 0.25F;

bool same_map(const splatbus_camera& a, const splatbus_camera& b) {
  const float* p = a.world_from_camera.translation;
  const float* q = b.world_from_camera.translation;
  return a.fx == b.fx && a.fy == b.fy && a.far_m == b.far_m && std::equal(p, p + 3, q);
}

}  // namespace

SunShadow::SunShadow(int size, const Bounds& casters, const Bounds& receivers)
    : size_(size), casters_(casters), receivers_(receivers) {
  const float across_m = casters.empty() ? 0 : glm::distance(casters.low, casters.high);
  maps_of_.resize(across_m > kWidestTexel_m * static_cast<float>(size) ? kCascades : 1);
  depth_.resize(size, static_cast<int>(maps_of_.size()));
}

splatbus_camera SunShadow::camera_of(std::size_t map, const glm::vec3& sun_direction, const glm::vec3& eye) const {
  const auto size = static_cast<std::uint32_t>(size_);
  if (map + 1 < maps_of_.size()) {
    const float texel_m = kFinestTexel_m * std::pow(kCascadeRatio, static_cast<float>(map));
    Bounds all = casters_;
    all.add(receivers_);
    return cascade_camera(eye, texel_m * static_cast<float>(size_), sun_direction, all, size, size,
                          kStep * static_cast<float>(size_));
  }
  splatbus_camera camera = fit_light_camera(casters_, sun_direction, size, size);
  // The depth range takes in the receivers: what lies beyond the far plane would fail every comparison.
  const Bounds seen = transformed(receivers_, camera_from_world(camera));
  camera.far_m = std::max(camera.far_m, seen.high.z + 0.1F);
  return camera;
}

void SunShadow::update(GpuScene& scene, const splatbus_light& light, const glm::vec3& eye,
                       const DepthPrograms& program_for) {
  const float* sun = light.sun_direction;
  for (std::size_t i = 0; i < maps_of_.size(); ++i) {
    Map& map = maps_of_[i];
    if (map.depth_version == light.sun_depth_version && (!cascades() || casters_.empty())) continue;
    const splatbus_camera camera = casters_.empty() ? splatbus_camera{} : camera_of(i, {sun[0], sun[1], sun[2]}, eye);
    if (map.depth_version == light.sun_depth_version && same_map(map.camera, camera)) continue;
    map = {camera, light.sun_depth_version};
    ++times_drawn_;
    depth_.draw_what_moved(static_cast<int>(i), scene, {camera, Projection::Orthographic}, program_for);
  }
}

void SunShadow::bind(GLuint program, float softness_m) const {
  if (!cascades()) return bind_one(program, softness_m);
  std::array<MapCamera, kCascades> cameras{};
  for (std::size_t i = 0; i < maps_of_.size(); ++i)
    cameras.at(i) = map_camera({maps_of_[i].camera, Projection::Orthographic});
  glProgramUniform4fv(program, kCascadeCameras, 4 * kCascades, glm::value_ptr(cameras.front().right));
  glBindTextureUnit(kSunMaps, depth_.layers());
}

void SunShadow::bind_one(GLuint program, float softness_m) const {
  constexpr float kGreatestSlope = 6;  // of the receiver, metres of depth a metre across
  const splatbus_camera& camera = maps_of_.front().camera;
  glm::mat4 shadow_from_world(1);
  glm::vec2 uv_a_metre(1);
  float metres_a_depth = 1;
  if (!casters_.empty()) {
    const glm::mat4 unit_from_clip = glm::scale(glm::translate(glm::mat4(1), glm::vec3(0.5F)), glm::vec3(0.5F));
    shadow_from_world = unit_from_clip * clip_from_camera(camera) * camera_from_world(camera);
    uv_a_metre = {camera.fx / static_cast<float>(size_), camera.fy / static_cast<float>(size_)};
    metres_a_depth = camera.far_m - camera.near_m;
  }
  const glm::vec2 radius = softness_m * uv_a_metre;
  const float across = 1 / std::min(uv_a_metre.x, uv_a_metre.y);
  const glm::vec4 filter{radius, kGreatestSlope * across / metres_a_depth,
                         kLiftTexels * across / static_cast<float>(size_)};
  const glm::mat3 shadow_normal = glm::inverseTranspose(glm::mat3(shadow_from_world));
  glProgramUniformMatrix4fv(program, kShadowFromWorld, 1, GL_FALSE, glm::value_ptr(shadow_from_world));
  glProgramUniformMatrix3fv(program, kShadowNormal, 1, GL_FALSE, glm::value_ptr(shadow_normal));
  glProgramUniform4fv(program, kShadowFilter, 1, glm::value_ptr(filter));
  glBindTextureUnit(kSunMaps, depth_.first());
}

}  // namespace splatbus::sim
