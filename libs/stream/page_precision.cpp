#include "stream/page_precision.h"

#include <algorithm>
#include <cmath>

namespace splatbus::stream {

namespace {

constexpr float kFaintest = 1e-3F;

}  // namespace

Precision::Precision(const StreamLayout& layout, float coarseness)
    : coarseness_(coarseness),
      finest_(std::log2(layout.at(Attribute::Mean).quantizer.step) + 7),
      octaves_per_step_(layout.at(Attribute::LogScale).quantizer.step / 0.6931472F),
      attributes_(layout.attributes()) {
  for (std::size_t a = 0; a < attributes_.size(); ++a) {
    rules_.emplace_back(layout, attributes_[a].attribute);
    if (attributes_[a].attribute == Attribute::LogScale) scale_ = a;
  }
  const AttributeChannels& opacity = layout.at(Attribute::Opacity);
  opacity_channel_ = static_cast<std::size_t>(opacity.first);
  for (std::size_t q = 0; q < log_opacity_.size(); ++q) {
    log_opacity_[q] = std::log2(std::max(static_cast<float>(q) * opacity.quantizer.step, kFaintest));
  }
}

Precision::Class Precision::of(const QuantizedGaussians& gaussians, std::size_t column, float weight) const {
  const AttributeChannels& scale = attributes_[scale_];
  const auto first = static_cast<std::size_t>(scale.first);
  Class out;
  for (std::size_t axis = 0; axis < 3; ++axis) out.log_scale[axis] = gaussians.channels[first + axis][column];
  if (lossless()) return out;
  const auto [x, y, z] = out.log_scale;
  const float octaves = 0.5F * static_cast<float>(x + y + z - std::min({x, y, z})) * octaves_per_step_;
  float shown = log_opacity_[static_cast<std::size_t>(gaussians.channels[opacity_channel_][column])];
  if (weight != 1) shown = std::max(shown + std::log2(std::max(weight, kFaintest)), std::log2(kFaintest));
  const float importance = shown + octaves - finest_;
  const float klass = std::clamp(coarseness_ - importance, -16.0F, 15.0F);
  out.number = static_cast<int>(klass);
  out.number -= static_cast<float>(out.number) > klass ? 1 : 0;  // rounded down, without a call
  const int at = shift(scale_, out);                             // the same for all sizes
  for (std::int32_t& value : out.log_scale) value = rounded(value, at, scale);
  return out;
}

void Precision::round(QuantizedGaussians& gaussians, std::span<const float> weight) const {
  if (lossless()) return;
  std::vector<Class> classes(gaussians.count());
  for (std::size_t i = 0; i < classes.size(); ++i) classes[i] = of(gaussians, i, weight.empty() ? 1.0F : weight[i]);
  for (std::size_t k = 0; k < attributes_.size(); ++k) {
    const AttributeChannels& a = attributes_[k];
    for (std::size_t i = 0; i < classes.size(); ++i) {
      const int by = shift(k, classes[i]);
      for (int c = a.first; c < a.first + a.channels; ++c) {
        std::int32_t& value = gaussians.channels[static_cast<std::size_t>(c)][i];
        value = rounded(value, by, a);
      }
    }
  }
}

}  // namespace splatbus::stream
