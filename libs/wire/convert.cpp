#include "wire/convert.h"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "wire/camera_struct.h"
#include "wire/picture_size.h"

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

wire::LightSource source_to_wire(const LightSource& source) {
  return {source.id,
          static_cast<wire::LightKind>(source.kind),
          source.casts_shadow,
          to_wire(source.position),
          to_wire(source.direction),
          to_wire(source.intensity),
          source.range_m,
          source.cos_inner,
          source.cos_outer,
          source.depth_version};
}

wire::ObjectFlags flags_of(const ObjectTransform& object) {
  auto flags = static_cast<wire::ObjectFlags>(0);
  if (object.emissive) flags |= wire::ObjectFlags::Emissive;
  if (!object.modelled) flags |= wire::ObjectFlags::NotModelled;
  return flags;
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

LightSource source_from_wire(const wire::LightSource& source) {
  const std::string field = fmt::format("light.sources, {}", source.id());
  const auto require = [&field](bool holds, const char* what) {
    if (!holds) refuse(fmt::format("{}: {}", field, what));
  };
  require(source.id() != 0, "0 is the sun");
  require(source.kind() <= wire::LightKind::MAX, "an unknown kind");
  LightSource out{.id = source.id(),
                  .kind = static_cast<LightKind>(source.kind()),
                  .casts_shadow = source.casts_shadow(),
                  .position = from_wire(source.position(), (field + ".position").c_str()),
                  .direction = from_wire(source.direction(), (field + ".direction").c_str()),
                  .intensity = light_from_wire(&source.intensity(), (field + ".intensity").c_str()),
                  .range_m = source.range_m(),
                  .cos_inner = source.cos_inner(),
                  .cos_outer = source.cos_outer(),
                  .depth_version = source.depth_version()};
  const float length = glm::length(out.direction);
  if (out.kind != LightKind::Point) {
    require(std::abs(length - 1) <= kUnitTolerance, "direction is not of length 1");
    out.direction /= length;
  }
  if (out.kind != LightKind::Directional) {
    require(std::isfinite(out.range_m) && out.range_m > 0, "range_m is not above 0");
  }
  if (out.kind == LightKind::Spot) {
    require(out.cos_outer >= -1 && out.cos_outer < out.cos_inner && out.cos_inner <= 1,
            "cos_outer and cos_inner do not make a cone");
  }
  return out;
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
  std::vector<wire::LightSource> sources;
  sources.reserve(light.sources.size());
  for (const LightSource& source : light.sources) sources.push_back(source_to_wire(source));
  const auto sources_offset = builder.CreateVectorOfStructs(sources);
  return wire::CreateLight(builder, light.generation, ambient, &direction, &irradiance, &background, sources_offset,
                           light.sun_depth_version);
}

flatbuffers::Offset<flatbuffers::Vector<const wire::ObjectTransform*>> to_wire(flatbuffers::FlatBufferBuilder& builder,
                                                                               const ObjectTransforms& objects) {
  std::vector<wire::ObjectTransform> structs;
  structs.reserve(objects.size());
  for (const auto& [id, world_from_object] : objects) {
    structs.emplace_back(id, to_wire(world_from_object.rigid), world_from_object.scale, flags_of(world_from_object));
  }
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
    refuse(fmt::format("camera.near_m, far_m ({}, {}) are not a range of depths", camera.near_m(), camera.far_m()));
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
  out.sun_depth_version = light.sun_depth_version();
  if (light.sources() == nullptr) return out;
  if (light.sources()->size() > kMaxLightSources) {
    refuse(fmt::format("light.sources has {} lights, at most {}", light.sources()->size(), kMaxLightSources));
  }
  for (const wire::LightSource* source : *light.sources()) {
    out.sources.push_back(source_from_wire(*source));
    if (out.sources.size() > 1 && out.sources[out.sources.size() - 2].id >= source->id()) {
      refuse(fmt::format("light.sources: {} after {}", source->id(), out.sources[out.sources.size() - 2].id));
    }
  }
  return out;
}

ObjectTransforms from_wire(const flatbuffers::Vector<const wire::ObjectTransform*>* objects) {
  ObjectTransforms out;
  if (objects == nullptr) return out;
  for (const wire::ObjectTransform* object : *objects) {
    const std::string field = fmt::format("object {}", object->id());
    ObjectTransform transform = from_wire(object->world_from_object(), field.c_str());
    transform.scale = object->scale();
    if (!(std::isnormal(transform.scale) && transform.scale > 0)) {
      refuse(fmt::format("{}.scale is {}, not above 0", field, transform.scale));
    }
    transform.emissive = (object->flags() & wire::ObjectFlags::Emissive) != wire::ObjectFlags{};
    transform.modelled = (object->flags() & wire::ObjectFlags::NotModelled) == wire::ObjectFlags{};
    if (!out.emplace(object->id(), transform).second) {
      refuse(fmt::format("{} has two transforms", field));
    }
  }
  return out;
}

}  // namespace splatbus
