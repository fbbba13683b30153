#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "stream/bytes.h"
#include "stream/layout.h"

// What encoder and decoder of PageCodec::Planes share: docs/page-codec.md. All of it is integer arithmetic, the same on
// every machine.
namespace splatbus::stream::planes {

inline constexpr std::uint8_t kFormat = 2;
enum Flags : std::uint8_t { kHasIds = 1, kOneObject = 2, kOwnOrder = 4 };

// Entropy coding: range asymmetric numeral systems (Duda 2014), words of 16 bits, kStates of them by turns.
inline constexpr int kStates = 8;
inline constexpr int kProbabilityBits = 11;
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

/// Precision: values of an attribute are multiples of 2^shift, and the shift follows from the Gaussian's class.
inline constexpr int kClasses = 32, kClassBias = 16;  ///< classes -16 to 15 are numbered from 0
inline constexpr int kMaxShift = 12;

/// How an attribute's shift follows from a Gaussian's class and its size.
class ShiftRule {
 public:
  ShiftRule(const StreamLayout& layout, Attribute attribute);
  /// Not clamped from below: what the class is added to. `log_scale`: the Gaussian's integers, x, y, z.
  [[nodiscard]] int offset(std::int32_t x, std::int32_t y, std::int32_t z) const {
    if (is_constant()) return constant_;
    const std::int32_t low = x < y ? x : y, high = x < y ? y : x;
    const std::int32_t largest = z > high ? z : high, middle = z > high ? high : (z > low ? z : low);
    if (attribute_ == Attribute::Mean) return constant_ + (middle * octaves_per_step_ >> kFraction);
    // How far a turn moves what the Gaussian shows grows with how much longer than wide it is.
    const std::int32_t eighths = (largest - middle) * octaves_per_step_ >> (kFraction - 3);
    return constant_ + (eighths < 1 ? 2 : (eighths < 3 ? 1 : (eighths < 6 ? 0 : -(eighths + 4) / 8)));
  }
  [[nodiscard]] int cap() const { return cap_; }
  /// Whether offset() is the same for all.
  [[nodiscard]] bool is_constant() const { return attribute_ != Attribute::Mean && attribute_ != Attribute::Rotation; }

 private:
  Attribute attribute_;
  int constant_ = 0, cap_ = 0;
  static constexpr int kFraction = 15;  // a difference of log-scales has 16 bits at most
  std::int32_t octaves_per_step_ = 0;   ///< of a log-scale, in 2^-kFraction
};

/// min(cap, max(0, klass + offset)); of the lowest class 0.
[[nodiscard]] constexpr int shift_at(int klass, int offset, int cap) {
  const int shift = klass + offset;
  return shift < 0 || klass <= -kClassBias ? 0 : (shift > cap ? cap : shift);
}

/// How a plane is predicted, and how its residuals are distributed. Two bytes, then `offset` as a zigzag varint.
enum class Predictor : std::uint8_t {
  Constant = 0,  ///< all values are the offset; nothing follows
  Offset = 1,    ///< the offset, and so much more a class
  Lane = 2,      ///< the lane before
  Channel = 3,   ///< the channel before; of a third colour the mean of both before
  Both = 4,      ///< the lane before and how the channel before has changed from there
};
inline constexpr int kPredictors = 5;

struct PlaneModel {
  Predictor predictor{};
  Shape shape{};
  int slope = 4;               ///< quarter octaves of spread that a shift by one takes away, 1 to 4
  int spread = 0;              ///< at a shift of 0
  std::int32_t per_class = 0;  ///< eighths that the offset grows by a class (Offset)
  std::int32_t offset = 0;
};

/// Where the means of a page lie: `low` bits of each axis travel plainly, `bits` above those on a Morton curve.
struct MortonGrid {
  std::array<std::int32_t, 3> origin{};  ///< multiples of 2^kMaxShift
  std::array<int, 3> bits{};             ///< at most kMaxCellBits each
  int low = 0;
};
inline constexpr int kMaxCellBits = 20, kMaxLowBits = 12;

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
[[nodiscard]] GapClass gap_class(std::uint64_t gap);
inline constexpr int kMaxGapClass = 127;
/// The smallest gap of a class, less nothing: gap + 1 = base + plain bits.
[[nodiscard]] constexpr std::uint64_t gap_base(int number) {
  const int exponent = number / 2;
  return exponent == 0 ? 1 : (std::uint64_t{2} | static_cast<std::uint64_t>(number & 1)) << (exponent - 1);
}
[[nodiscard]] constexpr int gap_plain_bits(int number) {
  return number / 2 > 0 ? number / 2 - 1 : 0;
}

}  // namespace splatbus::stream::planes
