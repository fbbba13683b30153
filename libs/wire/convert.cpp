#include "wire/convert.h"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "wire/camera_struct.h"

namespace splatbus {
namespace {

constexpr float kUnitTolerance = 0.01F;
constexpr std::size_t kAmbientFloats = 27;
static_assert(static_cast<int>(CameraRole::Light) == static_cast<int>(wire::CameraRole::Light) &&
              static_cast<int>(CameraRole::Light) == static_cast<int>(wire::CameraRole::MAX));

[[noreturn]] void refuse(const std::string& what) {
  throw std::runtime_error(what);
}

void check_finite(float value, const char* field, const char* member) {
  if (!std::isfinite(value)) refuse(fmt::format("{}.{} is {}, not a finite number", field, member, value));
}

void check_side(std::uint32_t side, const char* member) {
  if (side == 0 || side > kMaxPictureSide) {
    refuse(fmt::format("camera.{} is {}, not within 1 to {} pixels", member, side, kMaxPictureSide));
  }
}

wire::Quat quat_to_wire(const glm::quat& q) {
  return {q.w, q.x, q.y, q.z};
}

glm::quat quat_from_wire(const wire::Quat& q, const char* field) {
  const glm::quat out(q.w(), q.x(), q.y(), q.z());
  const float length = glm::length(out);
  if (!(std::abs(length - 1) <= kUnitTolerance)) {
    refuse(fmt::format("{}.rotation ({}, {}, {}, {}) has length {}, not 1", field, q.w(), q.x(), q.y(), q.z(), length));
  }
  return out / length;
}

/// Radiometric quantities: absent is zero, negative is refused.
glm::vec3 light_from_wire(const wire::Vec3* v, const char* field) {
  if (v == nullptr) return glm::vec3(0);
  const glm::vec3 out = from_wire(*v, field);
  if (glm::any(glm::lessThan(out, glm::vec3(0)))) {
    refuse(fmt::format("{} ({}, {}, {}) is negative", field, out.x, out.y, out.z));
  }
  return out;
}

glm::vec3 sun_direction_from_wire(const wire::Light& light, const glm::vec3& sun_irradiance) {
  const glm::vec3 direction =
      light.sun_direction() == nullptr ? glm::vec3(0) : from_wire(*light.sun_direction(), "light.sun_direction");
  const float length = glm::length(direction);
  if (std::abs(length - 1) <= kUnitTolerance) return direction / length;
  if (length == 0 && sun_irradiance == glm::vec3(0)) return Light{}.sun_direction;
  refuse(fmt::format("light.sun_direction ({}, {}, {}) has length {}, not 1", direction.x, direction.y, direction.z,
                     length));
}

}  // namespace

wire::Vec3 to_wire(const glm::vec3& v) {
  return {v.x, v.y, v.z};
}

wire::Rigid to_wire(const Rigid& rigid) {
  return {quat_to_wire(rigid.rotation), to_wire(rigid.translation)};
}

wire::Camera to_wire(const Camera& camera) {
  return camera_struct(camera, to_wire(camera.world_from_camera));
}

flatbuffers::Offset<wire::Light> to_wire(flatbuffers::FlatBufferBuilder& builder, const Light& light) {
  std::array<float, kAmbientFloats> planar{};
  for (std::size_t k = 0; k < light.ambient_sh.size(); ++k) {
    for (int color = 0; color < 3; ++color)
      planar[static_cast<std::size_t>(color) * 9 + k] = light.ambient_sh[k][color];
  }
  const auto ambient = builder.CreateVector(planar.data(), planar.size());
  const wire::Vec3 direction = to_wire(light.sun_direction), irradiance = to_wire(light.sun_irradiance),
                   background = to_wire(light.background);
  return wire::CreateLight(builder, light.generation, ambient, &direction, &irradiance, &background);
}

flatbuffers::Offset<flatbuffers::Vector<const wire::ObjectTransform*>> to_wire(flatbuffers::FlatBufferBuilder& builder,
                                                                               const ObjectTransforms& objects) {
  std::vector<wire::ObjectTransform> structs;
  structs.reserve(objects.size());
  for (const auto& [id, world_from_object] : objects) structs.emplace_back(id, to_wire(world_from_object));
  return builder.CreateVectorOfStructs(structs);
}

flatbuffers::Offset<wire::SceneState> to_wire(flatbuffers::FlatBufferBuilder& builder, const SceneState& scene,
                                              std::uint64_t frame, double time_s) {
  const auto objects = to_wire(builder, scene.objects);
  const auto light = to_wire(builder, scene.light);
  return wire::CreateSceneState(builder, frame, time_s, objects, light, scene.version);
}

SceneState from_wire(const wire::SceneState& scene) {
  return {.light = from_wire(*scene.light()), .objects = from_wire(scene.objects()), .version = scene.version()};
}

glm::vec3 from_wire(const wire::Vec3& v, const char* field) {
  check_finite(v.x(), field, "x");
  check_finite(v.y(), field, "y");
  check_finite(v.z(), field, "z");
  return {v.x(), v.y(), v.z()};
}

Rigid from_wire(const wire::Rigid& rigid, const char* field) {
  return {quat_from_wire(rigid.rotation(), field), from_wire(rigid.translation(), field)};
}

Camera from_wire(const wire::Camera& camera) {
  constexpr const char* kField = "camera";
  if (camera.role() > wire::CameraRole::MAX) {
    refuse(fmt::format("camera.role {} is unknown", static_cast<unsigned>(camera.role())));
  }
  check_side(camera.width(), "width");
  check_side(camera.height(), "height");
  check_finite(camera.fx(), kField, "fx");
  check_finite(camera.fy(), kField, "fy");
  check_finite(camera.cx(), kField, "cx");
  check_finite(camera.cy(), kField, "cy");
  check_finite(camera.near_m(), kField, "near_m");
  check_finite(camera.far_m(), kField, "far_m");
  if (!(camera.fx() > 0 && camera.fy() > 0)) {
    refuse(fmt::format("camera.fx, fy ({}, {}) are not positive", camera.fx(), camera.fy()));
  }
  if (!(camera.near_m() >= 0 && camera.far_m() > camera.near_m())) {
    refuse(fmt::format("camera.near_m, far_m ({}, {}) are no range of depths", camera.near_m(), camera.far_m()));
  }
  Camera out;
  out.id = camera.id();
  out.role = static_cast<CameraRole>(camera.role());
  out.width = camera.width();
  out.height = camera.height();
  out.fx = camera.fx();
  out.fy = camera.fy();
  out.cx = camera.cx();
  out.cy = camera.cy();
  out.near_m = camera.near_m();
  out.far_m = camera.far_m();
  out.world_from_camera = from_wire(camera.world_from_camera(), "camera.world_from_camera");
  return out;
}

Light from_wire(const wire::Light& light) {
  const flatbuffers::Vector<float>* ambient = light.ambient_sh();
  if (ambient == nullptr || ambient->size() != kAmbientFloats) {
    refuse(fmt::format("light.ambient_sh has {} numbers, not {}", ambient == nullptr ? 0 : ambient->size(),
                       kAmbientFloats));
  }
  Light out;
  out.generation = light.generation();
  for (flatbuffers::uoffset_t k = 0; k < 9; ++k) {
    for (int color = 0; color < 3; ++color) {
      const float value = ambient->Get(static_cast<flatbuffers::uoffset_t>(color) * 9 + k);
      if (!std::isfinite(value)) {
        refuse(fmt::format("light.ambient_sh[{}] is {}, not a finite number", color * 9 + static_cast<int>(k), value));
      }
      out.ambient_sh[k][color] = value;
    }
  }
  out.sun_irradiance = light_from_wire(light.sun_irradiance(), "light.sun_irradiance");
  out.background = light_from_wire(light.background(), "light.background");
  out.sun_direction = sun_direction_from_wire(light, out.sun_irradiance);
  return out;
}

ObjectTransforms from_wire(const flatbuffers::Vector<const wire::ObjectTransform*>* objects) {
  ObjectTransforms out;
  if (objects == nullptr) return out;
  for (const wire::ObjectTransform* object : *objects) {
    const std::string field = fmt::format("object {}", object->id());
    if (!out.emplace(object->id(), from_wire(object->world_from_object(), field.c_str())).second) {
      refuse(fmt::format("{} has two transforms", field));
    }
  }
  return out;
}

}  // namespace splatbus
