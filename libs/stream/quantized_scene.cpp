#include "stream/quantized_scene.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <string>

#include "stream/bytes.h"
#include "stream/coding.h"
#include "stream/layout.h"
#include "wire/common_generated.h"

namespace splatbus::stream {

namespace {

constexpr float kUnitTolerance = 0.01F;
constexpr float kDirectionUnit = 32767;
constexpr float kMinRange_m = 1e-6F;
constexpr int kRotationBits = 15;
constexpr std::int64_t kRotationMiddle = 1 << (kRotationBits - 1), kRotationUnit = kRotationMiddle - 1;
constexpr float kMaxSmallest = 0.76F;  // squares of the three smallest of a unit quaternion add up to 3/4 at most

[[noreturn]] void refuse_scene(const std::string& why) {
  throw StreamError("scene: " + why);
}

template <std::size_t N>
SharedExponent<N> quantize(const std::array<float, N>& values, const char* field) {
  float largest = 0;
  for (const float value : values) {
    if (!std::isfinite(value)) refuse_scene(fmt::format("{} is {}", field, value));
    largest = std::max(largest, std::abs(value));
  }
  int exponent = 0;
  std::frexp(largest, &exponent);
  SharedExponent<N> out;
  if (exponent < -126) return out;
  out.exponent = static_cast<std::int8_t>(std::min(exponent, 127));
  for (std::size_t i = 0; i < N; ++i) {
    const float mantissa = std::round(std::ldexp(values[i], kMantissaBits - out.exponent));
    out.mantissa[i] = static_cast<std::int16_t>(std::clamp<float>(mantissa, -kMaxMantissa, kMaxMantissa));
  }
  return out;
}

template <std::size_t N>
float value_of(const SharedExponent<N>& shared, std::size_t i) {
  return std::ldexp(static_cast<float>(shared.mantissa[i]), shared.exponent - kMantissaBits);
}

glm::vec3 color_of(const SharedExponent<3>& shared) {
  return {value_of(shared, 0), value_of(shared, 1), value_of(shared, 2)};
}

std::array<float, 3> array_of(const glm::vec3& v) {
  return {v.x, v.y, v.z};
}

std::array<std::int16_t, 2> quantize_direction(const glm::vec3& v, const std::string& field) {
  if (!(std::abs(glm::length(v) - 1) <= kUnitTolerance)) {
    refuse_scene(fmt::format("{} ({}, {}, {}) is not of length 1", field, v.x, v.y, v.z));
  }
  const coding::Octahedral e = coding::octahedral(v.x, v.y, v.z);
  return {static_cast<std::int16_t>(std::lround(e.x * kDirectionUnit)),
          static_cast<std::int16_t>(std::lround(e.y * kDirectionUnit))};
}

glm::vec3 dequantize(const std::array<std::int16_t, 2>& direction) {
  const auto [x, y, z] = coding::from_octahedral(
      {static_cast<float>(direction[0]) / kDirectionUnit, static_cast<float>(direction[1]) / kDirectionUnit});
  return {x, y, z};
}

std::array<std::int64_t, 3> quantize_position(const glm::vec3& position, const std::string& field) {
  std::array<std::int64_t, 3> out{};
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const float metres = position[static_cast<int>(axis)];
    if (!std::isfinite(metres)) refuse_scene(fmt::format("{}: position of {}", field, metres));
    constexpr auto kMost = static_cast<double>(kMaxPositionSteps);
    out[axis] = std::llround(std::clamp(static_cast<double>(metres) / kPositionStep_m, -kMost, kMost));
  }
  return out;
}

glm::vec3 dequantize(const std::array<std::int64_t, 3>& position) {
  glm::vec3 out;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    out[static_cast<int>(axis)] = static_cast<float>(static_cast<double>(position[axis]) * kPositionStep_m);
  }
  return out;
}

QuantizedSource quantize(const LightSource& source) {
  const std::string field = fmt::format("light {}", source.id);
  QuantizedSource out{.id = source.id, .kind = source.kind, .casts_shadow = source.casts_shadow};
  out.intensity = quantize(array_of(source.intensity), (field + ": intensity").c_str());
  if (source.kind != LightKind::Point) out.direction = quantize_direction(source.direction, field + ": direction");
  if (source.kind == LightKind::Directional) return out;
  out.position = quantize_position(source.position, field);
  if (!(std::isfinite(source.range_m) && source.range_m > 0)) {
    refuse_scene(fmt::format("{}: range_m of {}", field, source.range_m));
  }
  out.range_m = quantize(std::array{std::max(source.range_m, kMinRange_m)}, "range_m");
  if (source.kind == LightKind::Point) return out;
  if (!(source.cos_outer >= -1 && source.cos_outer < source.cos_inner && source.cos_inner <= 1)) {
    refuse_scene(fmt::format("{}: a cone from {} to {}", field, source.cos_inner, source.cos_outer));
  }
  out.inner = static_cast<std::int32_t>(std::lround(source.cos_inner / kCosineStep));
  out.outer = static_cast<std::int32_t>(std::lround(source.cos_outer / kCosineStep));
  // One that is narrower than a step is a step wide.
  out.outer = std::clamp(out.outer, -kMaxCosineSteps, kMaxCosineSteps - 1);
  out.inner = std::max(out.inner, out.outer + 1);
  return out;
}

LightSource dequantize(const QuantizedSource& source) {
  LightSource out{.id = source.id, .kind = source.kind, .casts_shadow = source.casts_shadow};
  out.intensity = color_of(source.intensity);
  if (source.kind != LightKind::Point) out.direction = dequantize(source.direction);
  if (source.kind == LightKind::Directional) return out;
  out.position = dequantize(source.position);
  out.range_m = value_of(source.range_m, 0);
  if (source.kind == LightKind::Point) return out;
  out.cos_inner = static_cast<float>(source.inner) * kCosineStep;
  out.cos_outer = static_cast<float>(source.outer) * kCosineStep;
  return out;
}

QuantizedLight quantize(const Light& light) {
  QuantizedLight out;
  out.sun_direction = quantize_direction(light.sun_direction, "sun_direction");
  out.sun_irradiance = quantize(array_of(light.sun_irradiance), "sun_irradiance");
  out.background = quantize(array_of(light.background), "background");
  std::array<float, 27> ambient{};
  for (std::size_t i = 0; i < ambient.size(); ++i) ambient[i] = light.ambient_sh[i / 3][static_cast<int>(i % 3)];
  out.ambient = quantize(ambient, "ambient_sh");
  return out;
}

void dequantize(const QuantizedLight& light, std::uint64_t generation, Light& out) {
  out.generation = generation;
  out.sun_direction = dequantize(light.sun_direction);
  out.sun_irradiance = color_of(light.sun_irradiance);
  out.background = color_of(light.background);
  for (std::size_t i = 0; i < light.ambient.mantissa.size(); ++i) {
    out.ambient_sh[i / 3][static_cast<int>(i % 3)] = value_of(light.ambient, i);
  }
}

std::uint64_t quantize_rotation(const glm::quat& q) {
  const std::array<float, 4> c{q.w, q.x, q.y, q.z};
  const auto largest = static_cast<std::size_t>(
      std::max_element(c.begin(), c.end(), [](float a, float b) { return std::abs(a) < std::abs(b); }) - c.begin());
  const float scale = (c[largest] < 0 ? -1.0F : 1.0F) * glm::root_two<float>() / glm::length(q);
  std::uint64_t bits = largest;
  for (std::size_t i = 0; i < 4; ++i) {
    if (i == largest) continue;
    const auto value = std::lround(c[i] * scale * static_cast<float>(kRotationUnit));
    bits = bits << kRotationBits |
           static_cast<std::uint64_t>(std::clamp<std::int64_t>(value, -kRotationUnit, kRotationUnit) + kRotationMiddle);
  }
  return bits;
}

/// The length of what the three smallest leave for the largest is not checked.
std::array<float, 3> smallest_of(std::uint64_t bits) {
  std::array<float, 3> smallest{};
  for (int i = 0; i < 3; ++i) {
    const std::uint64_t q = bits >> ((2 - i) * kRotationBits) & ((1U << kRotationBits) - 1);
    smallest[static_cast<std::size_t>(i)] = static_cast<float>(static_cast<std::int64_t>(q) - kRotationMiddle) /
                                            (static_cast<float>(kRotationUnit) * glm::root_two<float>());
  }
  return smallest;
}

float squares(const std::array<float, 3>& v) {
  return v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
}

glm::quat dequantize_rotation(std::uint64_t bits) {
  const auto smallest = smallest_of(bits);
  const auto largest = static_cast<std::size_t>(bits >> (3 * kRotationBits));
  std::array<float, 4> c{};
  std::size_t next = 0;
  for (std::size_t i = 0; i < 4; ++i) c[i] = i == largest ? std::sqrt(1 - squares(smallest)) : smallest[next++];
  return {c[0], c[1], c[2], c[3]};
}

QuantizedTransform quantize(const ObjectTransform& object, std::uint32_t id) {
  const float length = glm::length(object.rigid.rotation);
  if (!(std::abs(length - 1) <= kUnitTolerance))
    refuse_scene(fmt::format("object {}: rotation of length {}", id, length));
  if (!(std::isfinite(object.scale) && object.scale > 0)) {
    refuse_scene(fmt::format("object {}: scale of {}", id, object.scale));
  }
  const float octaves =
      std::clamp(std::log2(object.scale), -static_cast<float>(kMaxScaleOctaves), static_cast<float>(kMaxScaleOctaves));
  const auto flags = (object.emissive ? wire::ObjectFlags::Emissive : wire::ObjectFlags{}) |
                     (object.modelled ? wire::ObjectFlags{} : wire::ObjectFlags::NotModelled);
  return {.position = quantize_position(object.rigid.translation, fmt::format("object {}", id)),
          .rotation = quantize_rotation(object.rigid.rotation),
          .scale = static_cast<std::int32_t>(std::lround(octaves * kScaleStepsAnOctave)),
          .flags = static_cast<std::uint8_t>(flags)};
}

ObjectTransform dequantize(const QuantizedTransform& transform) {
  ObjectTransform out(
      {.rotation = dequantize_rotation(transform.rotation), .translation = dequantize(transform.position)});
  out.scale = std::exp2(static_cast<float>(transform.scale) / kScaleStepsAnOctave);
  const auto has = [&](wire::ObjectFlags flag) { return (transform.flags & static_cast<std::uint8_t>(flag)) != 0; };
  out.emissive = has(wire::ObjectFlags::Emissive);
  out.modelled = !has(wire::ObjectFlags::NotModelled);
  return out;
}

}  // namespace

QuantizedScene quantize_scene(const SceneState& scene) {
  if (scene.objects.size() > kMaxObjects) {
    refuse_scene(fmt::format("{} objects, at most {} can be streamed", scene.objects.size(), kMaxObjects));
  }
  if (scene.light.sources.size() > kMaxLightSources) {
    refuse_scene(fmt::format("{} lights, at most {} can be streamed", scene.light.sources.size(), kMaxLightSources));
  }
  QuantizedScene out{.version = scene.version,
                     .light_generation = scene.light.generation,
                     .light = quantize(scene.light),
                     .sources = {},
                     .objects = {}};
  for (const LightSource& source : scene.light.sources) {
    if (source.id <= (out.sources.empty() ? 0 : out.sources.back().id)) {
      refuse_scene(fmt::format("light {}: not in the order of ids", source.id));
    }
    out.sources.push_back(quantize(source));
  }
  out.objects.reserve(scene.objects.size());
  for (const auto& [id, world_from_object] : scene.objects)
    out.objects.push_back({id, quantize(world_from_object, id)});
  return out;
}

SceneState dequantize_scene(const QuantizedScene& scene) {
  SceneState out;
  dequantize_changes({}, scene, out);
  return out;
}

void dequantize_changes(const QuantizedScene& before, const QuantizedScene& after, SceneState& scene) {
  scene.version = after.version;
  dequantize(after.light, after.light_generation, scene.light);
  scene.light.sources.clear();
  for (const QuantizedSource& source : after.sources) scene.light.sources.push_back(dequantize(source));
  auto old = before.objects.begin();
  auto at = scene.objects.begin();  // of the same id as `old`
  for (const auto& [id, transform] : after.objects) {
    for (; old != before.objects.end() && old->id < id; ++old) at = scene.objects.erase(at);
    const bool known = old != before.objects.end() && old->id == id;
    if (!known) {
      scene.objects.emplace_hint(at, id, dequantize(transform));
      continue;
    }
    if (old->transform != transform) at->second = dequantize(transform);
    ++old;
    ++at;
  }
  scene.objects.erase(at, scene.objects.end());
}

bool is_rotation(std::uint64_t bits) {
  return bits >> (3 * kRotationBits + 2) == 0 && squares(smallest_of(bits)) <= kMaxSmallest;
}

}  // namespace splatbus::stream
