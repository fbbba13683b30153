#include "stream/page_precision.h"

#include <algorithm>
#include <cmath>

#include "stream/page_planes.h"

namespace splatbus::stream {

namespace {

/// The nearest multiple of 2^shift, half upwards, within the limits.
std::int32_t rounded(std::int32_t value, int shift, const AttributeChannels& a) {
  const std::int32_t nearest = (value + ((1 << shift) >> 1)) >> shift << shift;
  return nearest > a.maximum ? a.maximum >> shift << shift : nearest;
}

}  // namespace

void round_page(QuantizedGaussians& page, const StreamLayout& layout, float coarseness, std::span<const float> weight) {
  using namespace planes;
  const std::size_t count = page.count();
  const AttributeChannels& scale = layout.at(Attribute::LogScale);
  const AttributeChannels& opacity = layout.at(Attribute::Opacity);
  const auto planes_of = [&](const AttributeChannels& a) {
    return std::span(page.channels).subspan(static_cast<std::size_t>(a.first), static_cast<std::size_t>(a.channels));
  };
  const auto log_scale = planes_of(scale);
  std::vector<int> klass(count);
  const float finest = std::log2(layout.at(Attribute::Mean).quantizer.step) + 7;
  for (std::size_t i = 0; i < count; ++i) {
    const std::int32_t x = log_scale[0][i], y = log_scale[1][i], z = log_scale[2][i];
    const auto two_largest = static_cast<float>(x + y + z - std::min({x, y, z}));
    const float octaves = 0.5F * two_largest * scale.quantizer.step / 0.6931472F;
    const float shown = static_cast<float>(page.channels[static_cast<std::size_t>(opacity.first)][i]) *
                        opacity.quantizer.step * (weight.empty() ? 1.0F : weight[i]);
    const float importance = std::log2(std::max(shown, 1e-3F)) + octaves - finest;
    klass[i] = static_cast<int>(std::clamp(std::floor(coarseness - importance), -16.0F, 15.0F));
  }
  const auto round_attribute = [&](const AttributeChannels& a) {
    const ShiftRule rule(layout, a.attribute);
    const auto planes = planes_of(a);
    for (std::size_t i = 0; i < count; ++i) {
      const int offset = rule.offset(log_scale[0][i], log_scale[1][i], log_scale[2][i]);
      const int shift = shift_at(klass[i], offset, rule.cap());
      for (auto& plane : planes) plane[i] = rounded(plane[i], shift, a);
    }
  };
  round_attribute(scale);  // which the others' rules read
  for (const AttributeChannels& a : layout.attributes()) {
    if (a.attribute != Attribute::LogScale) round_attribute(a);
  }
}

}  // namespace splatbus::stream
