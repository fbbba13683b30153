#pragma once

#include <cstddef>
#include <cstdint>
#include <iterator>

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

/// Numbers that depend on a seed, a key and how many were drawn before.
class Draw {
 public:
  Draw(std::uint32_t seed, std::uint32_t key) : seed_(seed), key_(key) {}
  float between(float low, float high) { return low + (high - low) * random01(seed_, key_, use_++); }
  bool chance(float of_one) { return between(0, 1) < of_one; }
  std::uint32_t below(std::size_t count) {
    return static_cast<std::uint32_t>(between(0, 1) * static_cast<float>(count));
  }
  float sign() { return chance(0.5F) ? 1.0F : -1.0F; }
  template <class List>
  const auto& of(const List& list) {
    return list[below(std::size(list))];
  }

 private:
  std::uint32_t seed_, key_, use_ = 0;
};

}  // namespace splatbus::sim
