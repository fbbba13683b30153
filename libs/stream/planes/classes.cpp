#include "stream/planes/classes.h"

#include <algorithm>
#include <bit>
#include <span>

namespace splatbus::stream::planes {

namespace {

/// Of the lowest bit that is set; 127 below it where none is, far above any cap.
std::int32_t trailing_zeros(std::int32_t bits) {
  // By way of the exponent of a float, which compilers vectorise.
  const auto lowest =
      static_cast<float>(static_cast<std::int32_t>(static_cast<std::uint32_t>(bits & -bits) & 0x7FFFFFFF));
  const std::int32_t exponent = static_cast<std::int32_t>(std::bit_cast<std::uint32_t>(lowest) >> 23U) - 127;
  return exponent < 0 ? 31 : exponent;
}

}  // namespace

std::vector<std::uint8_t> classes_of(const QuantizedGaussians& page, const StreamLayout& layout) {
  constexpr std::int32_t kHighest = kClasses - 1 - kClassBias;
  const std::size_t count = page.count();
  std::vector<std::int32_t> highest(count, kHighest), any(count);
  const auto scale = static_cast<std::size_t>(layout.at(Attribute::LogScale).first);
  const std::int32_t* const size[3] = {page.channels[scale].data(), page.channels[scale + 1].data(),
                                       page.channels[scale + 2].data()};
  for (const AttributeChannels& a : layout.attributes()) {
    const ShiftRule rule(layout, a.attribute);
    if (rule.cap() == 0) continue;
    std::fill(any.begin(), any.end(), 0);
    for (const auto& plane :
         std::span(page.channels).subspan(static_cast<std::size_t>(a.first), static_cast<std::size_t>(a.channels))) {
      for (std::size_t i = 0; i < count; ++i) any[i] |= plane[i];
    }
    const int cap = rule.cap();
    const auto bound = [&](auto offset_of) {
      for (std::size_t i = 0; i < count; ++i) {
        const std::int32_t zeros = trailing_zeros(any[i]);
        const std::int32_t most = zeros < cap ? zeros - offset_of(i) : kHighest;
        highest[i] = most < highest[i] ? most : highest[i];
      }
    };
    if (rule.is_constant()) {
      bound([offset = rule.offset(0, 0, 0)](std::size_t) { return offset; });
    } else {
      bound([&](std::size_t i) { return rule.offset(size[0][i], size[1][i], size[2][i]); });
    }
  }
  std::vector<std::uint8_t> out(count), shift(count);
  for (std::size_t i = 0; i < count; ++i) {
    out[i] = static_cast<std::uint8_t>(std::clamp(highest[i] + kClassBias, 0, kClasses - 1));
  }
  std::size_t shifts = 0;
  for (const AttributeChannels& a : layout.attributes()) {
    put_shifts(ShiftRule(layout, a.attribute), out, size, shift.data());
    for (std::size_t i = 0; i < count; ++i) shifts += shift[i];
    if (shifts >= count) return out;
  }
  std::fill(out.begin(), out.end(), std::uint8_t{0});
  return out;
}

}  // namespace splatbus::stream::planes
