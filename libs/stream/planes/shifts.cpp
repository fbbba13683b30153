#include "stream/planes/shifts.h"

#include <array>
#include <cmath>

namespace splatbus::stream::planes {

ShiftRule::ShiftRule(const StreamLayout& layout, Attribute attribute) : attribute_(attribute) {
  const float step = layout.at(attribute).quantizer.step;
  const float octaves = layout.at(Attribute::LogScale).quantizer.step * 1.442695F;
  octaves_per_step_ =
      static_cast<std::int32_t>(std::floor((octaves > 1.0F ? 1.0F : octaves) * (1 << kFraction) + 0.5F));
  // Found by what gives 50 dB in the fewest bytes: docs/decisions/0110-page-codec.md.
  const auto fine_at = [&](float unit, int cap) {
    constant_ = std::ilogb(unit / step);
    cap_ = cap;
  };
  switch (attribute) {
    case Attribute::Mean:
      constant_ = -std::ilogb(step) - 6;
      cap_ = 10;
      break;
    case Attribute::LogScale:
      fine_at(1.0F / 128, 6);
      break;
    case Attribute::Rotation:
      fine_at(1.0F / 128, 7);
      break;
    case Attribute::Opacity:
      fine_at(1.0F / 3200, 4);
      break;
    case Attribute::Albedo:
      fine_at(1.0F / 200, 6);
      break;
    case Attribute::Visibility:
      break;  // exact: it is the lights' to say, beside the blob
    case Attribute::Residual:
      fine_at(1.0F / 512, 7);
      break;
    case Attribute::Normal:
      fine_at(1.0F / 256, 6);
      break;
    case Attribute::ShDc:
      fine_at(1.0F / 64, 7);
      break;
    case Attribute::ShRest:
      fine_at(1.0F / 128, 7);
      break;
  }
}

void put_shifts(const ShiftRule& rule, std::span<const std::uint8_t> klass, const std::int32_t* const log_scale[3],
                std::uint8_t* shift) {
  if (rule.is_constant()) {
    std::array<std::uint8_t, kClasses> of_class;
    for (int k = 0; k < kClasses; ++k) {
      of_class[static_cast<std::size_t>(k)] =
          static_cast<std::uint8_t>(shift_at(k - kClassBias, rule.offset(0, 0, 0), rule.cap()));
    }
    for (std::size_t i = 0; i < klass.size(); ++i) shift[i] = of_class[klass[i]];
    return;
  }
  for (std::size_t i = 0; i < klass.size(); ++i) {
    const int offset = rule.offset(log_scale[0][i], log_scale[1][i], log_scale[2][i]);
    shift[i] = static_cast<std::uint8_t>(shift_at(klass[i] - kClassBias, offset, rule.cap()));
  }
}

}  // namespace splatbus::stream::planes
