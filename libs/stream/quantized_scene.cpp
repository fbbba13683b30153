#include "stream/quantized_scene.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <string>

#include "stream/bytes.h"
#include "stream/coding.h"
#include "stream/layout.h"

namespace splatbus::stream {

namespace {

constexpr float kUnitTolerance = 0.01F;
constexpr float kDirectionUnit = 32767;
constexpr int kRotationBits = 15;
constexpr std::int64_t kRotationMiddle = 1 << (kRotationBits - 1), kRotationUnit = kRotationMiddle - 1;
constexpr float kMaxSmallest = 0.76F;  // squares of the three smallest of a unit quaternion add up to 3/4 at most

[[noreturn]] void refuse(const std::string& why) {
  throw StreamError("scene: " + why);
}

template <std::size_t N>
SharedExponent<N> quantize(const std::array<float, N>& values, const char* field) {
  float largest = 0;
  for (const float value : values) {
    if (!std::isfinite(value)) refuse(fmt::format("{} is {}", field, value));
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

QuantizedLight quantize(const Light& light) {
  QuantizedLight out;
  const glm::vec3& sun = light.sun_direction;
  if (!(std::abs(glm::length(sun) - 1) <= kUnitTolerance)) {
    refuse(fmt::format("sun_direction ({}, {}, {}) is not of length 1", sun.x, sun.y, sun.z));
  }
  const coding::Octahedral e = coding::octahedral(sun.x, sun.y, sun.z);
  out.sun_direction = {static_cast<std::int16_t>(std::lround(e.x * kDirectionUnit)),
                       static_cast<std::int16_t>(std::lround(e.y * kDirectionUnit))};
  out.sun_irradiance = quantize(array_of(light.sun_irradiance), "sun_irradiance");
  out.background = quantize(array_of(light.background), "background");
  std::array<float, 27> ambient{};
  for (std::size_t i = 0; i < ambient.size(); ++i) ambient[i] = light.ambient_sh[i / 3][static_cast<int>(i % 3)];
  out.ambient = quantize(ambient, "ambient_sh");
  return out;
}

Light dequantize(const QuantizedLight& light, std::uint64_t generation) {
  const auto [x, y, z] = coding::from_octahedral({static_cast<float>(light.sun_direction[0]) / kDirectionUnit,
                                                  static_cast<float>(light.sun_direction[1]) / kDirectionUnit});
  Light out{.generation = generation,
            .sun_direction = {x, y, z},
            .sun_irradiance = color_of(light.sun_irradiance),
            .background = color_of(light.background)};
  for (std::size_t i = 0; i < light.ambient.mantissa.size(); ++i) {
    out.ambient_sh[i / 3][static_cast<int>(i % 3)] = value_of(light.ambient, i);
  }
  return out;
}

std::uint64_t quantize_rotation(const glm::quat& q) {
  const std::array<float, 4> c{q.w, q.x, q.y, q.z};
  const auto largest = static_cast<std::size_t>(
      std::ranges::max_element(c, {}, [](float value) { return std::abs(value); }) - c.begin());
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

QuantizedTransform quantize(const Rigid& transform, std::uint32_t id) {
  const float length = glm::length(transform.rotation);
  if (!(std::abs(length - 1) <= kUnitTolerance)) refuse(fmt::format("object {}: rotation of length {}", id, length));
  QuantizedTransform out{.position = {}, .rotation = quantize_rotation(transform.rotation)};
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const float position = transform.translation[static_cast<int>(axis)];
    if (!std::isfinite(position)) refuse(fmt::format("object {}: position of {}", id, position));
    constexpr auto kMost = static_cast<double>(kMaxPositionSteps);
    out.position[axis] = std::llround(std::clamp(static_cast<double>(position) / kPositionStep_m, -kMost, kMost));
  }
  return out;
}

}  // namespace

QuantizedScene quantize_scene(const SceneState& scene) {
  if (scene.objects.size() > kMaxObjects) {
    refuse(fmt::format("{} objects, at most {} can be streamed", scene.objects.size(), kMaxObjects));
  }
  QuantizedScene out{.version = scene.version,
                     .light_generation = scene.light.generation,
                     .light = quantize(scene.light),
                     .objects = {}};
  for (const auto& [id, world_from_object] : scene.objects) {
    out.objects.emplace_hint(out.objects.end(), id, quantize(world_from_object.rigid, id));
  }
  return out;
}

SceneState dequantize_scene(const QuantizedScene& scene) {
  SceneState out{.light = dequantize(scene.light, scene.light_generation), .objects = {}, .version = scene.version};
  for (const auto& [id, transform] : scene.objects) {
    Rigid rigid{.rotation = dequantize_rotation(transform.rotation), .translation = {}};
    for (std::size_t axis = 0; axis < 3; ++axis) {
      rigid.translation[static_cast<int>(axis)] =
          static_cast<float>(static_cast<double>(transform.position[axis]) * kPositionStep_m);
    }
    out.objects.emplace_hint(out.objects.end(), id, rigid);
  }
  return out;
}

bool is_rotation(std::uint64_t bits) {
  return bits >> (3 * kRotationBits + 2) == 0 && squares(smallest_of(bits)) <= kMaxSmallest;
}

}  // namespace splatbus::stream
