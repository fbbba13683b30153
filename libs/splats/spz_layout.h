#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>

// What reader and writer of SPZ files share.
namespace splatbus::splats::spz {

static_assert(std::endian::native == std::endian::little, "numbers lie in memory as in the file");

inline constexpr std::uint32_t kMagic = 0x5053474E;  // "NGSP"
inline constexpr int kMaxDegree = 4;
inline constexpr float kColorScale = 0.15F;
enum Flags : std::uint8_t { kAntialiased = 1, kHasExtensions = 2 };

/// What versions before 4 begin with, under gzip; the attributes follow one after the other.
struct Header {
  std::uint32_t magic = kMagic, version = 0, count = 0;
  std::uint8_t sh_degree = 0, fractional_bits = 0, flags = 0;
  std::uint8_t streams = 0;  ///< reserved before version 4
};
static_assert(sizeof(Header) == 16);
/// What follows in version 4, in the clear. At toc_offset two u64 a stream, its compressed and its plain size, then the
/// streams, each zstd's.
struct Header4 {
  std::uint32_t toc_offset = sizeof(Header) + 16;
  std::array<std::uint8_t, 12> reserved{};
};
static_assert(sizeof(Header4) == 16);

/// In the order of the file.
enum Attribute : std::uint8_t { kPosition, kAlpha, kColor, kScale, kRotation, kSh, kAttributes };

/// Bytes of one Gaussian.
inline std::array<std::size_t, kAttributes> attribute_bytes(std::uint32_t version, int sh_degree) {
  const auto coefficients = static_cast<std::size_t>((sh_degree + 1) * (sh_degree + 1) - 1);
  return {9, 1, 3, 3, version >= 3 ? std::size_t{4} : std::size_t{3}, 3 * coefficients};
}

}  // namespace splatbus::splats::spz
