#pragma once

#include "gaussians/light.h"
#include "math/portable.h"

// GLM's types as kernels take them.
namespace splatbus {

[[nodiscard]] inline math::Vec3 portable(const glm::vec3& v) {
  return {v.x, v.y, v.z};
}

[[nodiscard]] inline math::Mat3 portable(const glm::quat& rotation) {
  return math::rotation_matrix(rotation.w, rotation.x, rotation.y, rotation.z);
}

[[nodiscard]] inline math::Rigid portable(const Rigid& rigid) {
  return {portable(rigid.rotation), portable(rigid.translation)};
}

/// world_from_object.
[[nodiscard]] inline math::Similarity portable(const ObjectTransform& object) {
  return {portable(object.rigid.rotation), portable(object.rigid.translation), object.scale};
}

}  // namespace splatbus
