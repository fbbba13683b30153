#include <algorithm>
#include <glm/glm.hpp>
#include <numbers>

#include "raster/cpu/frame.h"

namespace splatbus::raster::cpu {
namespace {

constexpr float kInversePi = std::numbers::inv_pi_v<float>;
constexpr std::array<float, 9> kClampedCosineOverPi = {1,     2.0F / 3, 2.0F / 3, 2.0F / 3, 0.25F,
                                                       0.25F, 0.25F,    0.25F,    0.25F};

ObjectFrame make_frame(const ObjectTransform& object, const Rigid& camera_from_world, const Light& light_world) {
  ObjectFrame frame;
  const Rigid camera_from_object = camera_from_world * object.rigid;
  const glm::mat3 rotation = glm::mat3_cast(glm::normalize(camera_from_object.rotation));
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) {
      frame.camera_from_object[3 * row + column] = object.scale * rotation[column][row];
    }
    frame.translation[row] = camera_from_object.translation[row];
  }
  frame.scale = object.scale;
  frame.emissive = object.emissive;
  const glm::vec3 camera_position = -(glm::transpose(rotation) * camera_from_object.translation) / object.scale;
  const Light light = light_in_object(light_world, object);
  const Sh9 sun_basis = sh9_basis(light.sun_direction);
  for (int c = 0; c < 3; ++c) {
    frame.camera_position[c] = camera_position[c];
    frame.sun_direction[c] = light.sun_direction[c];
    frame.sun_over_pi[c] = light.sun_irradiance[c] * kInversePi;
    for (int k = 0; k < 9; ++k) {
      frame.ambient[3 * k + c] = light.ambient_sh[k][c];
      frame.ambient_lobe[3 * k + c] = light.ambient_sh[k][c] * kClampedCosineOverPi[k];
      frame.sun_sh[3 * k + c] = light.sun_irradiance[c] * sun_basis[k] * kInversePi;
    }
  }
  return frame;
}

}  // namespace

void ObjectTable::build(const Camera& camera, const SceneState& scene) {
  const Rigid camera_from_world = inverse(camera.world_from_camera);
  Light light = scene.light;
  light.sources.clear();  // which Frame::sources has
  ids_.clear();
  frames_.assign(1, make_frame(Rigid{}, camera_from_world, light));
  for (const auto& [id, world_from_object] : scene.objects) {
    ids_.push_back(id);
    const ObjectTransform seen = seen_from(camera.world_from_camera.translation, id, world_from_object);
    frames_.push_back(make_frame(seen, camera_from_world, light));
  }
}

std::uint32_t ObjectTable::find(std::uint32_t object_id) const {
  if (object_id == kWorldFrame) return 0;
  const auto found = std::lower_bound(ids_.begin(), ids_.end(), object_id);
  if (found == ids_.end() || *found != object_id) return kHidden;
  return static_cast<std::uint32_t>(found - ids_.begin()) + 1;
}

}  // namespace splatbus::raster::cpu
