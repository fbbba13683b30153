#pragma once

#include <cmath>
#include <glm/glm.hpp>
#include <vector>

#include "relight/visibility.h"

namespace splatbus::relight::test {

constexpr float kBallRadius_m = 0.5F;
inline const glm::vec3 kBallCentre{0, 0.8F, 0};

struct HostMap {
  Camera camera;
  std::vector<float> depth_m;
  [[nodiscard]] LightDepthMap view() const { return {.camera = camera, .depth_m = depth_m.data()}; }
};

/// A ball over the floor y = 0, seen by the sun in an orthographic map of 6 m.
class BallOverFloor {
 public:
  explicit BallOverFloor(const glm::vec3& to_sun, std::uint32_t texels = 512) : to_sun_(glm::normalize(to_sun)) {
    constexpr float kSide_m = 6.0F;
    camera_ = look_at(10.0F * to_sun_, glm::vec3(0), texels, texels, 1.0F);
    camera_.role = CameraRole::Light;
    camera_.fx = camera_.fy = static_cast<float>(texels) / kSide_m;
    camera_.cx = camera_.cy = static_cast<float>(texels) / 2.0F;
    camera_.far_m = 40.0F;
    depth_m_.resize(std::size_t{texels} * texels);
    for (std::uint32_t y = 0; y < texels; ++y) {
      for (std::uint32_t x = 0; x < texels; ++x) {
        const glm::vec3 origin = unproject(camera_, static_cast<float>(x) + 0.5F, static_cast<float>(y) + 0.5F, 0.0F);
        depth_m_[std::size_t{y} * texels + x] = first_hit_m(origin, -to_sun_);
      }
    }
  }

  [[nodiscard]] float first_hit_m(const glm::vec3& origin, const glm::vec3& direction) const {
    const glm::vec3 offset = origin - kBallCentre;
    const float b = glm::dot(offset, direction);
    const float discriminant = b * b - glm::dot(offset, offset) + kBallRadius_m * kBallRadius_m;
    if (discriminant > 0 && -b - std::sqrt(discriminant) > 0) return -b - std::sqrt(discriminant);
    return direction.y < 0 ? -origin.y / direction.y : camera_.far_m;
  }

  /// As a pinhole of that pose sees it.
  [[nodiscard]] HostMap pinhole(const Rigid& world_from_camera, float half_tangent, std::uint32_t texels) const {
    HostMap map{.camera = {.role = CameraRole::Light, .width = texels, .height = texels, .far_m = 40}, .depth_m = {}};
    map.camera.cx = map.camera.cy = static_cast<float>(texels) / 2.0F;
    map.camera.fx = map.camera.fy = map.camera.cx / half_tangent;
    map.camera.world_from_camera = world_from_camera;
    for (std::uint32_t y = 0; y < texels; ++y) {
      for (std::uint32_t x = 0; x < texels; ++x) {
        const glm::vec3 ray((static_cast<float>(x) + 0.5F - map.camera.cx) / map.camera.fx,
                            (static_cast<float>(y) + 0.5F - map.camera.cy) / map.camera.fy, 1);
        const glm::vec3 direction = world_from_camera.rotation * glm::normalize(ray);
        map.depth_m.push_back(first_hit_m(world_from_camera.translation, direction) / glm::length(ray));
      }
    }
    return map;
  }

  /// The six faces about a point, turned against the world's axes.
  [[nodiscard]] std::vector<HostMap> faces(const glm::vec3& position, std::uint32_t texels) const {
    const glm::quat turned = glm::normalize(glm::quat(1, 0.1F, 0.2F, -0.05F));
    std::vector<HostMap> faces;
    for (int k = 0; k < 6; ++k) {
      const glm::vec3 axis = k < 4 ? glm::vec3(0, 1, 0) : glm::vec3(1, 0, 0);
      const float angle = k < 4 ? 1.5707964F * static_cast<float>(k) : (k == 4 ? 1.5707964F : -1.5707964F);
      faces.push_back(
          pinhole({.rotation = turned * glm::angleAxis(angle, axis), .translation = position}, 1.0F, texels));
    }
    return faces;
  }

  /// Distance of a point to the edge of the ball's shadow in the light of a point, metres at the ball; negative inside.
  [[nodiscard]] static float distance_to_shadow_edge_m(const glm::vec3& light, const glm::vec3& point) {
    const glm::vec3 way = glm::normalize(point - light), to_ball = kBallCentre - light;
    return glm::length(to_ball - glm::dot(to_ball, way) * way) - kBallRadius_m;
  }

  /// Distance of a floor point to the edge of the ball's shadow, metres; negative inside.
  [[nodiscard]] float distance_to_shadow_edge_m(const glm::vec3& point) const {
    const glm::vec3 offset = kBallCentre - point;
    return glm::length(offset - glm::dot(offset, to_sun_) * to_sun_) - kBallRadius_m;
  }

  static GaussiansBuffer gaussians(const std::vector<glm::vec3>& points, const std::vector<glm::vec3>& normals,
                                   std::uint32_t object = 0) {
    GaussiansBuffer gaussians(ParameterLayout{}, points.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
      for (int c = 0; c < 3; ++c) {
        const std::size_t at = static_cast<std::size_t>(c) * gaussians.stride() + i;
        gaussians.surface_point[at] = points[i][c];
        gaussians.parameters[at] = points[i][c];
        gaussians.normal[at] = normals[i][c];
        gaussians.parameters[(ParameterLayout::kLogScale + static_cast<std::size_t>(c)) * gaussians.stride() + i] =
            std::log(0.01F);
      }
      gaussians.object_id[i] = object;
    }
    return gaussians;
  }

  [[nodiscard]] LightDepthMap map() const { return {.camera = camera_, .depth_m = depth_m_.data()}; }
  [[nodiscard]] MappedLight sun() const {
    return {.source = {.kind = LightKind::Directional, .direction = to_sun_}, .maps = {map()}};
  }

  /// 1 for all of the sun.
  [[nodiscard]] std::vector<float> visibility(const std::vector<glm::vec3>& points,
                                              const std::vector<glm::vec3>& normals,
                                              const ObjectTransforms& objects = {}, std::uint32_t object = 0,
                                              const VisibilityOptions& options = {}) const {
    return visibility(sun(), gaussians(points, normals, object), objects, options);
  }
  static std::vector<float> visibility(const MappedLight& light, const GaussiansBuffer& model,
                                       const ObjectTransforms& objects = {}, const VisibilityOptions& options = {}) {
    std::vector<std::uint8_t> bytes(model.count());
    compute_visibility({}, model.view(), objects, {{light}}, options, bytes.data());
    std::vector<float> out;
    for (const std::uint8_t byte : bytes) out.push_back(static_cast<float>(byte) / 255);
    return out;
  }

  [[nodiscard]] const glm::vec3& to_sun() const { return to_sun_; }

 private:
  glm::vec3 to_sun_;
  Camera camera_;
  std::vector<float> depth_m_;
};

struct Points {
  std::vector<glm::vec3> position, normal;
};

inline Points floor_points() {
  Points points;
  for (int x = -60; x <= 60; ++x) {
    for (int z = -60; z <= 60; ++z) {
      points.position.emplace_back(0.0203F * static_cast<float>(x), 0.0F, 0.0203F * static_cast<float>(z));
      points.normal.emplace_back(0, 1, 0);
    }
  }
  return points;
}

inline Points ball_points() {
  Points points;
  constexpr int kCount = 6000;
  for (int i = 0; i < kCount; ++i) {
    const float y = 1.0F - 2.0F * (static_cast<float>(i) + 0.5F) / kCount;
    const float ring = std::sqrt(1.0F - y * y);
    const float angle = 2.39996323F * static_cast<float>(i);
    const glm::vec3 normal(ring * std::cos(angle), y, ring * std::sin(angle));
    points.position.push_back(kBallCentre + kBallRadius_m * normal);
    points.normal.push_back(normal);
  }
  return points;
}

}  // namespace splatbus::relight::test
