#pragma once

#include <cstdint>

namespace splatbus::sim {

/// A number in [0, 1) that depends on nothing but its arguments (PCG output function over a mixed key, O'Neill 2014).
[[nodiscard]] inline float random01(std::uint32_t seed, std::uint32_t x, std::uint32_t y) {
  std::uint32_t state = seed * 747796405U + 2891336453U;
  for (const std::uint32_t key : {x, y}) {
    state = (state ^ key) * 747796405U + 2891336453U;
    state = ((state >> ((state >> 28U) + 4U)) ^ state) * 277803737U;
    state ^= state >> 22U;
  }
  return static_cast<float>(state >> 8U) / 16777216.0F;
}

}  // namespace splatbus::sim
