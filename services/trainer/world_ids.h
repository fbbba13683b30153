#pragma once

#include <cstdint>
#include <span>

namespace splatbus::trainer {

/// Of who is in a page, in order: two pages of one key that have the same have the same Gaussians, whatever became of
/// their values. Never 0.
[[nodiscard]] inline std::uint64_t hash_of_ids(std::span<const std::uint64_t> ids) {
  constexpr std::uint64_t kOdd = 0x9E3779B97F4A7C15U;
  std::uint64_t hash = ids.size();
  for (const std::uint64_t id : ids) {
    hash = (hash ^ id) * kOdd;
    hash ^= hash >> 32U;
  }
  return hash | 1U;
}

}  // namespace splatbus::trainer
