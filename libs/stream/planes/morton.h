#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>

// Where means lie on a Morton curve.
namespace splatbus::stream::planes {

inline constexpr int kMaxCellBits = 20, kMaxLowBits = 12;

/// Where the means of a page lie: `low` bits of each axis travel plainly, `bits` above those on a Morton curve.
struct MortonGrid {
  std::array<std::int32_t, 3> origin{};  ///< multiples of 2^kMaxShift
  std::array<int, 3> bits{};             ///< at most kMaxCellBits each
  int low = 0;
};

/// Bits of three axes, interleaved from the lowest; an axis that has no more is passed over.
class Interleaver {
 public:
  explicit Interleaver(const std::array<int, 3>& bits);
  [[nodiscard]] std::uint64_t operator()(const std::array<std::uint32_t, 3>& cell) const {
    std::uint64_t key = 0;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      for (std::size_t byte = 0; byte < 3; ++byte) key |= part_[axis][byte][cell[axis] >> (8 * byte) & 0xFF];
    }
    return key;
  }

 private:
  std::array<std::array<std::array<std::uint64_t, 256>, 3>, 3> part_;  ///< [axis][byte of the cell]
};

/// The other way: x, y and z in kMaxCellBits each, lowest first. What a key has above the axes' bits is left out.
class Deinterleaver {
 public:
  explicit Deinterleaver(const std::array<int, 3>& bits);
  [[nodiscard]] std::uint64_t operator()(std::uint64_t key) const {
    std::uint64_t cell = 0;
    for (std::size_t byte = 0; byte < 8; ++byte) cell |= part_[byte][key >> (8 * byte) & 0xFF];
    return cell;
  }

 private:
  std::array<std::array<std::uint64_t, 256>, 8> part_;  ///< [byte of the key]
};

/// A number from 0 as a class, twice its binary logarithm with one bit below, and what that leaves open.
struct GapClass {
  int number = 0, plain_bits = 0;
};
[[nodiscard]] constexpr GapClass gap_class(std::uint64_t gap) {
  const int exponent = gap + 1 == 0 ? 64 : static_cast<int>(std::bit_width(gap + 1)) - 1;
  if (exponent == 0) return {};
  return {2 * exponent + static_cast<int>((gap + 1) >> (exponent - 1) & 1), exponent - 1};
}
inline constexpr int kMaxGapClass = 128;
/// The smallest gap of a class, less nothing: gap + 1 = base + plain bits.
[[nodiscard]] constexpr std::uint64_t gap_base(int number) {
  const int exponent = number / 2;
  return exponent == 0 ? 1 : (std::uint64_t{2} | static_cast<std::uint64_t>(number & 1)) << (exponent - 1);
}
[[nodiscard]] constexpr int gap_plain_bits(int number) {
  return number / 2 > 0 ? number / 2 - 1 : 0;
}

}  // namespace splatbus::stream::planes
