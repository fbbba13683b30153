#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

// The entropy coding of PageCodec::Planes: range asymmetric numeral systems (Duda 2014), words of 16 bits, kStates of
// them by turns, with frequencies from a few tables that both ends make.
namespace splatbus::stream::planes {

inline constexpr std::size_t kStates = 16;
inline constexpr int kProbabilityBits = 10;
inline constexpr std::uint32_t kProbabilityOne = 1U << kProbabilityBits;
inline constexpr std::uint32_t kStateLow = 1U << 15;  ///< a state is in [kStateLow, 2^31)

/// A residual's symbol: zigzag(residual) below kEscape, or kEscape, and then its bits are among the plain ones: those
/// of a plane's escapes first, then the low bits of all its lanes.
inline constexpr int kSymbols = 64, kEscape = kSymbols - 1;
/// Spreads of a distribution: a quarter of an octave apart, from 0.1.
inline constexpr int kSpreads = 24;
enum class Shape : std::uint8_t { Laplace, Gauss };
inline constexpr int kTables = 2 * kSpreads;

struct Tables {
  using Frequencies = std::array<std::uint16_t, kSymbols>;  ///< sum kProbabilityOne; 0: the symbol has none, escape
  std::array<Frequencies, kTables> frequency;               ///< [shape][spread]
};
/// Made on first use.
[[nodiscard]] const Tables& tables();

/// A spread in quarter octaves above 0.1: up to kSpreads as a table, above that with plain low bits.
struct Spread {
  int table = 0;     ///< within the shape
  int low_bits = 0;  ///< of the residual, plain
};
inline constexpr int kMaxSpread = kSpreads + 4 * 26;
[[nodiscard]] constexpr Spread spread_of(int index) {
  if (index < kSpreads) return {index < 0 ? 0 : index, 0};
  const int low_bits = (index - kSpreads) / 4 + 1;
  return {index - 4 * low_bits, low_bits};
}

}  // namespace splatbus::stream::planes
