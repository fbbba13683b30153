#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include "sample_scene.h"

namespace splatbus::expander::test {

/// A room of 8 x 4 x 8 metres with a ball that moves, seen from inside.
struct RoomScene {
  static constexpr std::uint32_t kBall = 7;
  static constexpr float kBallRadius_m = 0.6F;
  Rigid world_from_ball{.translation = {0.5F, 0.8F, -0.3F}};

  struct Hit {
    float along = 0;
    glm::vec3 normal{0};
    std::uint32_t object_id = 0;
  };

  /// The first surface along a ray from inside.
  [[nodiscard]] Hit trace(const glm::vec3& origin, const glm::vec3& direction) const {
    Hit hit{.along = 1e9F};
    const std::array<glm::vec2, 3> walls = {glm::vec2(-4, 4), glm::vec2(0, 4), glm::vec2(-4, 4)};
    for (int axis = 0; axis < 3; ++axis) {
      if (direction[axis] == 0) continue;
      const float wall =
          direction[axis] > 0 ? walls[static_cast<std::size_t>(axis)].y : walls[static_cast<std::size_t>(axis)].x;
      const float along = (wall - origin[axis]) / direction[axis];
      if (along >= hit.along) continue;
      hit = {.along = along, .normal = glm::vec3(0), .object_id = 1 + static_cast<std::uint32_t>(axis)};
      hit.normal[axis] = direction[axis] > 0 ? -1.0F : 1.0F;
    }
    const glm::vec3 to_ball = world_from_ball.translation - origin;
    const float middle = glm::dot(to_ball, direction) / glm::dot(direction, direction);
    const glm::vec3 miss = to_ball - middle * direction;
    const float inside = kBallRadius_m * kBallRadius_m - glm::dot(miss, miss);
    if (inside > 0 && middle > 0) {
      const float along = middle - std::sqrt(inside / glm::dot(direction, direction));
      if (along < hit.along) {
        hit = {.along = along, .normal = (along * direction - to_ball) / kBallRadius_m, .object_id = kBall};
      }
    }
    return hit;
  }
};

/// Every pixel of `cameras` cameras of size x size pixels that stand about the room's middle, turned by `turn` radians.
inline HostRound room_round(const RoomScene& scene, std::uint32_t cameras, std::uint32_t size, float turn = 0) {
  HostRound samples;
  samples.rig_generation = 1;
  samples.scene.objects[RoomScene::kBall] = scene.world_from_ball;
  samples.scene.light.sun_direction = glm::normalize(glm::vec3(0.3F, 0.9F, 0.2F));
  samples.scene.light.sun_irradiance = {2.0F, 1.8F, 1.5F};
  for (std::size_t k = 0; k < 9; ++k)
    samples.scene.light.ambient_sh[k] = glm::vec3(0.5F, 0.4F, 0.3F) / (1.0F + static_cast<float>(k));
  std::mt19937 random(42);
  std::uniform_real_distribution<float> uniform(0, 1);
  for (std::uint32_t c = 0; c < cameras; ++c) {
    const float angle = turn + 6.2831853F * static_cast<float>(c) / static_cast<float>(cameras);
    const glm::vec3 eye(1.5F * std::cos(angle), 1.7F, 1.5F * std::sin(angle));
    const glm::vec3 target = c % 2 == 0 ? -eye : 3.0F * eye;
    const Camera camera = look_at(eye, {target.x, 0.9F, target.z}, size, size, 1.2F);
    samples.cameras.push_back(camera);
    for (std::uint32_t y = 0; y < size; ++y) {
      for (std::uint32_t x = 0; x < size; ++x) {
        const glm::vec3 direction =
            unproject(camera, static_cast<float>(x) + 0.5F, static_cast<float>(y) + 0.5F, 1) - eye;
        const RoomScene::Hit hit = scene.trace(eye, direction);
        samples.position.push_back(eye + hit.along * direction);
        samples.normal.push_back(hit.normal);
        samples.albedo.emplace_back(uniform(random), uniform(random), uniform(random));
        samples.color.emplace_back(uniform(random), uniform(random), uniform(random));
        const float cosine = -glm::dot(hit.normal, glm::normalize(direction));
        samples.spacing_m.push_back(hit.along / camera.fx / std::sqrt(std::max(cosine, 0.05F)));
        samples.object_id.push_back(hit.object_id);
      }
    }
  }
  return samples;
}

}  // namespace splatbus::expander::test
