#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "gaussians/light.h"

namespace splatbus::stream {

// What a scene loses on its way, at most. A light's irradiance, background and ambient coefficients are each off by a
// part of kMaxLightError of the largest among them.
inline constexpr float kPositionStep_m = 1.0F / 4096;
inline constexpr float kMaxPositionError_m = kPositionStep_m / 2;  ///< along each axis, and the rounding of the float
inline constexpr float kMaxRotationError_rad = 1.5e-4F;
inline constexpr float kMaxSunError_rad = 7e-5F;
inline constexpr float kMaxLightError = 1.0F / 4096;
inline constexpr float kMaxDirectionError_rad = kMaxSunError_rad;  ///< of a light's axis
inline constexpr float kMaxRangeError = 1.0F / 4096;               ///< part of it
inline constexpr float kCosineStep = 1.0F / (1 << 20);
inline constexpr int kScaleStepsAnOctave = 8192;
inline constexpr float kMaxScaleError = 4.3e-5F;  ///< part of it; 1 is exact

/// When a scene state was: the engine's frame, and CLOCK_MONOTONIC of its machine (0: unknown).
struct SceneInstant {
  std::uint64_t frame = 0;
  std::int64_t capture_ns = 0;
  bool operator==(const SceneInstant&) const = default;
};

/// world_from_object.
struct QuantizedTransform {
  std::array<std::int64_t, 3> position{};  ///< kPositionStep_m
  /// 47 bits: which of w x y z is largest, then the three others, 15 bits each; the largest is positive.
  std::uint64_t rotation = 0;
  std::int32_t scale = 0;  ///< its binary logarithm, kScaleStepsAnOctave
  std::uint8_t flags = 0;  ///< of wire::ObjectFlags
  bool operator==(const QuantizedTransform&) const = default;
};

struct QuantizedObject {
  std::uint32_t id = 0;
  QuantizedTransform transform;
  bool operator==(const QuantizedObject&) const = default;
};

inline constexpr int kMantissaBits = 12;
inline constexpr std::int16_t kMaxMantissa = (1 << kMantissaBits) - 1;

/// value = mantissa * 2^(exponent - kMantissaBits).
template <std::size_t N>
struct SharedExponent {
  std::int8_t exponent = 0;
  std::array<std::int16_t, N> mantissa{};
  bool operator==(const SharedExponent&) const = default;
};

struct QuantizedLight {
  std::array<std::int16_t, 2> sun_direction{};  ///< octahedral, 32767 is 1
  SharedExponent<3> sun_irradiance, background;
  SharedExponent<27> ambient;  ///< [coefficient][R G B]
  bool operator==(const QuantizedLight&) const = default;
};

/// A light besides the sun. What its kind does not use is 0.
struct QuantizedSource {
  std::uint32_t id = 0;
  LightKind kind{};
  bool casts_shadow = false;
  std::array<std::int64_t, 3> position{};   ///< kPositionStep_m
  std::array<std::int16_t, 2> direction{};  ///< octahedral, 32767 is 1
  SharedExponent<3> intensity;
  SharedExponent<1> range_m;          ///< above 0
  std::int32_t inner = 0, outer = 0;  ///< cosines, kCosineStep
  bool operator==(const QuantizedSource&) const = default;
};

/// A scene state as the integers that travel: what server and viewer hold alike, so that deltas do not add up errors.
struct QuantizedScene {
  std::uint64_t version = 0, light_generation = 0;
  QuantizedLight light;
  std::vector<QuantizedSource> sources;  ///< by ascending id
  std::vector<QuantizedObject> objects;  ///< by ascending id
  bool operator==(const QuantizedScene&) const = default;
};

/// Positions are clamped to kMaxPositionSteps, scales to 2^kMaxScaleOctaves and its inverse. Throws StreamError, naming
/// the field, on values that are not finite, rotations and directions that are not near unit, scales, ranges and cones
/// that are none, more than kMaxObjects objects, and lights that are too many or not by ascending id.
[[nodiscard]] QuantizedScene quantize_scene(const SceneState& scene);
[[nodiscard]] SceneState dequantize_scene(const QuantizedScene& scene);
/// What dequantize_scene(after) gives, into `scene`, which is that of `before`: only what differs is touched.
void dequantize_changes(const QuantizedScene& before, const QuantizedScene& after, SceneState& scene);
inline constexpr std::int64_t kMaxPositionSteps = std::int64_t{1} << 33;
inline constexpr int kMaxScaleOctaves = 64;
inline constexpr std::int32_t kMaxCosineSteps = 1 << 20;

/// Whether the bits are a rotation's.
[[nodiscard]] bool is_rotation(std::uint64_t bits);

}  // namespace splatbus::stream
