#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <map>

#include "gaussians/light.h"

namespace splatbus::stream {

// What a scene loses on its way, at most. A light's irradiance, background and ambient coefficients are each off by a
// part of kMaxLightError of the largest among them.
inline constexpr float kPositionStep_m = 1.0F / 4096;
inline constexpr float kMaxPositionError_m = kPositionStep_m / 2;  ///< along each axis, and the rounding of the float
inline constexpr float kMaxRotationError_rad = 1.5e-4F;
inline constexpr float kMaxSunError_rad = 7e-5F;
inline constexpr float kMaxLightError = 1.0F / 4096;

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
  bool operator==(const QuantizedTransform&) const = default;
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

/// A scene state as the integers that travel: what server and viewer hold alike, so that deltas do not add up errors.
struct QuantizedScene {
  std::uint64_t version = 0, light_generation = 0;
  QuantizedLight light;
  std::map<std::uint32_t, QuantizedTransform> objects;
  bool operator==(const QuantizedScene&) const = default;
};

/// Positions are clamped to kMaxPositionSteps. Throws StreamError, naming the field, on values that are not finite,
/// rotations and directions that are not near unit, and more than kMaxObjects objects.
[[nodiscard]] QuantizedScene quantize_scene(const SceneState& scene);
[[nodiscard]] SceneState dequantize_scene(const QuantizedScene& scene);
inline constexpr std::int64_t kMaxPositionSteps = std::int64_t{1} << 40;

/// Whether the bits are a rotation's.
[[nodiscard]] bool is_rotation(std::uint64_t bits);

}  // namespace splatbus::stream
