#pragma once

#include <cstdint>
#include <string_view>

namespace splatbus::bus {

// Rendezvous hashing (Thaler and Ravishankar 1998): an item is that replica's for which the two weigh most, so that all
// who know the same replicas agree without a word, and one that comes or goes moves no item between the others.

/// SplitMix64's finaliser.
[[nodiscard]] constexpr std::uint64_t mixed(std::uint64_t x) {
  x = (x ^ (x >> 30U)) * 0xbf58476d1ce4e5b9U;
  x = (x ^ (x >> 27U)) * 0x94d049bb133111ebU;
  return x ^ (x >> 31U);
}

/// FNV-1a; every replica computes the same, whatever its standard library.
[[nodiscard]] constexpr std::uint64_t hash_of(std::string_view text) {
  std::uint64_t hash = 0xcbf29ce484222325U;
  for (const char c : text) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3U;
  return hash;
}

/// `name`: hash_of() the replica's. Of equal weights the larger name counts.
[[nodiscard]] constexpr std::uint64_t rendezvous_weight(std::uint64_t name, std::uint32_t item) {
  return mixed(name + 0x9e3779b97f4a7c15U * (std::uint64_t{item} + 1));
}

}  // namespace splatbus::bus
