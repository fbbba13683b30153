#include "sim/sun_shadow.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/gtc/matrix_inverse.hpp>
#include <glm/gtc/matrix_transform.hpp>
#include <glm/gtc/type_ptr.hpp>
#include <numeric>
#include <span>

#include "sim/projection.h"

namespace splatbus::sim {
namespace {

constexpr float kFinestTexel_m = 0.012F;  // of the first cascade
constexpr float kCascadeRatio = 4;        // of a cascade's texels to those of the one before
constexpr float kWidestTexel_m = 0.025F;  // of a map that is alone
/// Of a cascade's width: what it moves by. The cameras that follow one viewer then share a map, and a walk draws it
/// anew every 6 m. It reaches at least three eighths of its width from an eye.
constexpr float kStep = 0.25F;

/// Layers of each cascade: what surrounds a corner of its places lies in four of them. The last one is everybody's.
constexpr std::array<std::size_t, kCascades> kKept{4, 4, 1};

std::size_t first_layer(std::size_t cascade) {
  return std::accumulate(kKept.begin(), kKept.begin() + static_cast<std::ptrdiff_t>(cascade), std::size_t{0});
}

bool same_map(const splatbus_camera& a, const splatbus_camera& b) {
  const float* p = a.world_from_camera.translation;
  const float* q = b.world_from_camera.translation;
  return a.fx == b.fx && a.fy == b.fy && a.far_m == b.far_m && std::equal(p, p + 3, q);
}

}  // namespace

SunShadow::SunShadow(int size, const Bounds& casters, const Bounds& receivers)
    : size_(size),
      casters_(casters),
      receivers_(receivers),
      cascades_(!casters.empty() &&
                glm::distance(casters.low, casters.high) > kWidestTexel_m * static_cast<float>(size)) {
  maps_.resize(cascades_ ? first_layer(kCascades) : 1);
  depth_.resize(size, static_cast<int>(maps_.size()));
}

splatbus_camera SunShadow::camera_of(std::size_t cascade, const glm::vec3& sun_direction, const glm::vec3& eye) const {
  const auto size = static_cast<std::uint32_t>(size_);
  if (cascades_ && cascade + 1 < kCascades) {
    const float texel_m = kFinestTexel_m * std::pow(kCascadeRatio, static_cast<float>(cascade));
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

std::size_t SunShadow::layer_for(std::size_t cascade, const splatbus_camera& camera) const {
  if (!cascades_) return 0;
  const std::size_t first = first_layer(cascade);
  const std::span maps = std::span(maps_).subspan(first, kKept.at(cascade));
  auto found = std::ranges::find_if(maps, [&](const Map& map) { return same_map(map.camera, camera); });
  if (found == maps.end()) found = std::ranges::min_element(maps, {}, &Map::used);
  return first + static_cast<std::size_t>(found - maps.begin());
}

void SunShadow::update(GpuScene& scene, const splatbus_light& light, const glm::vec3& eye,
                       const DepthPrograms& program_for) {
  const float* sun = light.sun_direction;
  ++updates_;
  for (std::size_t cascade = 0; cascade < (cascades_ ? current_.size() : 1); ++cascade) {
    if (!cascades_ && maps_.front().depth_version == light.sun_depth_version) continue;
    const splatbus_camera camera =
        casters_.empty() ? splatbus_camera{} : camera_of(cascade, {sun[0], sun[1], sun[2]}, eye);
    const std::size_t layer = current_.at(cascade) = layer_for(cascade, camera);
    Map& map = maps_[layer];
    map.used = updates_;
    if (map.depth_version == light.sun_depth_version && same_map(map.camera, camera)) continue;
    map.camera = camera;
    map.depth_version = light.sun_depth_version;
    ++times_drawn_;
    depth_.draw_what_moved(static_cast<int>(layer), scene, {camera, Projection::Orthographic}, program_for);
  }
}

void SunShadow::bind(GLuint program, float softness_m) const {
  if (!cascades()) return bind_one(program, softness_m);
  std::array<MapCamera, kCascades> cameras{};
  std::array<float, kCascades> layers{};
  for (std::size_t i = 0; i < kCascades; ++i) {
    cameras.at(i) = map_camera({maps_[current_.at(i)].camera, Projection::Orthographic});
    layers.at(i) = static_cast<float>(current_.at(i));
  }
  glProgramUniform1fv(program, kCascadeLayers, kCascades, layers.data());
  glProgramUniform4fv(program, kCascadeCameras, 4 * kCascades, glm::value_ptr(cameras.front().right));
  glBindTextureUnit(kSunMaps, depth_.layers());
}

void SunShadow::bind_one(GLuint program, float softness_m) const {
  constexpr float kGreatestSlope = 6;  // of the receiver, metres of depth a metre across
  const splatbus_camera& camera = maps_.front().camera;
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
