#pragma once

#include <cstdint>
#include <span>

#include "stream/layout.h"

// Precision: values of an attribute are multiples of 2^shift, and the shift follows from the Gaussian's class and size.
namespace splatbus::stream::planes {

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
    return constant_ + (eighths < 1 ? 2 : (eighths < 3 ? 1 : (eighths < 6 ? 0 : -((eighths + 4) >> 3))));
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

/// Shifts of `klass` (numbered from 0) into `shift`. `log_scale`: planes x, y, z, at least as long.
void put_shifts(const ShiftRule& rule, std::span<const std::uint8_t> klass, const std::int32_t* const log_scale[3],
                std::uint8_t* shift);

}  // namespace splatbus::stream::planes
