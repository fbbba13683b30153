#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "stream/planes/shifts.h"
#include "stream/quantized.h"

namespace splatbus::stream {

/// How coarse each Gaussian's values may be: an error of a value counts in pictures by the Gaussian's opacity and the
/// area that it covers, so that the small and the faint may be coarse where the large and the opaque are fine. Values
/// stay integers of the layout, multiples of a power of two, 2^shift, that follows from the Gaussian alone;
/// PageCodec::Planes then leaves out the zeros.
class Precision {
 public:
  /// Rounds nothing.
  static constexpr float kLossless = -20;

  /// `coarseness`: octaves; one more is one bit less a value, of those that are not as fine as the layout already.
  Precision(const StreamLayout& layout, float coarseness);

  [[nodiscard]] bool lossless() const { return coarseness_ <= kLossless; }

  /// What of a Gaussian decides.
  struct Class {
    int number = -planes::kClassBias;
    std::array<std::int32_t, 3> log_scale{};  ///< rounded
  };
  /// `weight`: what the Gaussian's opacity is multiplied by, such as how much of it is seen.
  [[nodiscard]] Class of(const QuantizedGaussians& gaussians, std::size_t column, float weight = 1) const;
  /// Of the layout's attribute of that index.
  [[nodiscard]] int shift(std::size_t attribute, const Class& of) const {
    if (of.number <= -planes::kClassBias) return 0;
    const planes::ShiftRule& rule = rules_[attribute];
    return planes::shift_at(of.number, rule.offset(of.log_scale[0], of.log_scale[1], of.log_scale[2]), rule.cap());
  }
  /// The nearest multiple of 2^shift, half upwards, within the attribute's limits.
  [[nodiscard]] static std::int32_t rounded(std::int32_t value, int shift, const AttributeChannels& a) {
    const std::int32_t nearest = (value + ((1 << shift) >> 1)) >> shift << shift;
    return nearest > a.maximum ? a.maximum >> shift << shift : nearest;
  }

  /// All columns. `weight`: [count] or empty.
  void round(QuantizedGaussians& gaussians, std::span<const float> weight = {}) const;

 private:
  float coarseness_, finest_, octaves_per_step_;
  std::vector<AttributeChannels> attributes_;
  std::vector<planes::ShiftRule> rules_;  ///< [attributes]
  std::size_t scale_ = 0;                 ///< index of LogScale
  std::size_t opacity_channel_ = 0;
  std::array<float, 256> log_opacity_{};  ///< octaves, by integer
};

}  // namespace splatbus::stream
