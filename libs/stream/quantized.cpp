#include "stream/quantized.h"

#include <algorithm>
#include <cassert>

#include "stream/coding.h"

namespace splatbus::stream {

coding::Step step_of(const AttributeChannels& a) {
  return {.offset = a.quantizer.offset,
          .per_step = 1 / a.quantizer.step,
          .minimum = static_cast<float>(a.minimum),
          .maximum = static_cast<float>(a.maximum)};
}

coding::Kind coding_of(Attribute attribute) {
  switch (attribute) {
    case Attribute::Rotation:
      return coding::Kind::Rotation;
    case Attribute::Normal:
      return coding::Kind::Normal;
    case Attribute::Opacity:
      return coding::Kind::Opacity;
    case Attribute::Albedo:
      return coding::Kind::Albedo;
    case Attribute::Visibility:
      return coding::Kind::Visibility;
    default:
      return coding::Kind::Plain;
  }
}

QuantizedGaussians::QuantizedGaussians(const StreamLayout& layout, std::size_t count) : channels(layout.channels()) {
  resize(count);
}

void QuantizedGaussians::resize(std::size_t count) {
  // Whoever lets it grow a little at a time asks for more than is needed now: doubled once more, it would not fit a
  // page.
  const auto exactly = [count](auto& plane) {
    plane.reserve(count);
    plane.resize(count);
  };
  for (auto& plane : channels) exactly(plane);
  exactly(object_id);
  exactly(gaussian_id);
}

void QuantizedGaussians::append(const QuantizedGaussians& other) {
  assert(channels.size() == other.channels.size());
  for (std::size_t c = 0; c < channels.size(); ++c) {
    channels[c].insert(channels[c].end(), other.channels[c].begin(), other.channels[c].end());
  }
  object_id.insert(object_id.end(), other.object_id.begin(), other.object_id.end());
  gaussian_id.insert(gaussian_id.end(), other.gaussian_id.begin(), other.gaussian_id.end());
}

QuantizedGaussians QuantizedGaussians::gather(std::span<const std::uint32_t> columns) const {
  QuantizedGaussians out;
  out.channels.resize(channels.size());
  out.resize(columns.size());
  for (std::size_t c = 0; c < channels.size(); ++c) {
    for (std::size_t i = 0; i < columns.size(); ++i) out.channels[c][i] = channels[c][columns[i]];
  }
  for (std::size_t i = 0; i < columns.size(); ++i) {
    out.object_id[i] = object_id[columns[i]];
    out.gaussian_id[i] = gaussian_id[columns[i]];
  }
  return out;
}

void QuantizedGaussians::remove(std::span<const std::uint32_t> ascending) {
  for (auto& plane : channels) remove_at(plane, ascending);
  remove_at(object_id, ascending);
  remove_at(gaussian_id, ascending);
}

PageBounds bounds_of(const QuantizedGaussians& gaussians, const StreamLayout& layout, std::uint32_t first,
                     std::uint32_t count) {
  const AttributeChannels &mean = layout.at(Attribute::Mean), &scale = layout.at(Attribute::LogScale);
  const auto value = [&](const AttributeChannels& a, int c, std::uint32_t i) {
    return a.quantizer.offset + a.quantizer.step * static_cast<float>(gaussians.channels[a.first + c][i]);
  };
  PageBounds bounds;
  for (std::uint32_t i = first; i < first + count; ++i) {
    include(bounds, {value(mean, 0, i), value(mean, 1, i), value(mean, 2, i)},
            std::max({value(scale, 0, i), value(scale, 1, i), value(scale, 2, i)}));
  }
  return bounds;
}

}  // namespace splatbus::stream
