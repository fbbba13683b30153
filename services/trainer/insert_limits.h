#pragma once

#include <cstdint>

// What a row of model/insert may be, for the checks in host memory and on the device.
namespace splatbus::trainer {

inline constexpr std::uint32_t kMaxInsertRows = 1U << 22;
inline constexpr float kMaxDistance_m = 1e6F;
inline constexpr float kMinLogScale = -16.0F, kMaxLogScale = 8.0F;  // a tenth of a micrometre to three kilometres
inline constexpr float kMaxOpacityLogit = 12.0F;
inline constexpr float kUnitTolerance = 0.05F;  // of a normal's length

// Beyond these a value is taken for garbage, and its row is dropped.
inline constexpr float kMaxAnyLogScale = 100.0F;
inline constexpr float kMaxAnyNormal = 2.0F;
inline constexpr float kMaxAny = 1e3F;
inline constexpr float kMinRotationLength = 1e-3F;

}  // namespace splatbus::trainer
