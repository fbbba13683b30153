#include "stream/quantized.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>

#include "stream/coding.h"

namespace splatbus::stream {

namespace {

constexpr std::size_t kBlock = 1024;  // columns whose planes are read in turn

float linear_odd(float encoded) {
  const float x = std::abs(encoded);
  const float y = x <= 0.04045F ? x / 12.92F : std::pow((x + 0.055F) / 1.055F, 2.4F);
  return std::copysign(y, encoded);
}

glm::vec3 from_octahedral(const glm::vec2& e) {
  glm::vec3 n(e.x, e.y, 1 - std::abs(e.x) - std::abs(e.y));
  if (n.z < 0) {
    n = {(1 - std::abs(e.y)) * coding::sign_not_zero(e.x), (1 - std::abs(e.x)) * coding::sign_not_zero(e.y), n.z};
  }
  const float length = glm::length(n);
  return length > 0 ? n / length : glm::vec3(0, 0, 1);
}

void quantise_rotation(const GaussiansView& in, const StreamLayout& layout, QuantizedGaussians& out,
                       const QuantizedGaussians* held, const std::uint32_t* held_column) {
  const AttributeChannels& a = layout.at(Attribute::Rotation);
  const coding::Step step = step_of(a);
  const float* w = in.plane(ParameterLayout::kRotation);
  const float* x = in.plane(ParameterLayout::kRotation + 1);
  const float* y = in.plane(ParameterLayout::kRotation + 2);
  const float* z = in.plane(ParameterLayout::kRotation + 3);
  for (std::size_t i = 0; i < in.count; ++i) {
    const coding::Quaternion q = coding::normalized({w[i], x[i], y[i], z[i]});
    coding::Quaternion reference;
    if (held && held_column && held_column[i] != kNotHeld) {
      const auto value = [&](int channel) {
        return static_cast<float>(held->channels[a.first + channel][held_column[i]]) * a.quantizer.step;
      };
      reference = coding::from_rotation_vector({value(0), value(1), value(2)});
    }
    const coding::Vector v = coding::to_rotation_vector(coding::nearest_equivalent(q, reference));
    out.channels[a.first][i] = step(v.x);
    out.channels[a.first + 1][i] = step(v.y);
    out.channels[a.first + 2][i] = step(v.z);
  }
}

void quantise_normal(const GaussiansView& in, const AttributeChannels& a, QuantizedGaussians& out) {
  const coding::Step step = step_of(a);
  for (std::size_t i = 0; i < in.count; ++i) {
    const coding::Octahedral e =
        in.normal ? coding::octahedral(in.normal[i], in.normal[in.stride + i], in.normal[2 * in.stride + i])
                  : coding::octahedral(0, 1, 0);
    out.channels[a.first][i] = step(e.x);
    out.channels[a.first + 1][i] = step(e.y);
  }
}

// What is not finite makes a sum of products with zero no number; unlike a test, that vectorizes.
void add_nothing(const float* plane, std::size_t count, std::array<float, kBlock>& sum) {
  for (std::size_t i = 0; i < count; ++i) sum[i] += 0.0F * plane[i];
}

void find_unusable(const GaussiansView& in, std::vector<std::uint8_t>& usable) {
  usable.resize(in.count);
  const bool transfer = in.layout.appearance == Appearance::Transfer;
  std::array<float, kBlock> sum{};
  for (std::size_t first = 0; first < in.count; first += kBlock) {
    const std::size_t count = std::min(kBlock, in.count - first);
    sum.fill(0);
    for (int c = 0; c < in.layout.channels(); ++c) add_nothing(in.plane(c) + first, count, sum);
    for (std::size_t c = 0; transfer && in.normal && c < 3; ++c) {
      add_nothing(in.normal + c * in.stride + first, count, sum);
    }
    if (transfer && in.visibility) add_nothing(in.visibility + first, count, sum);
    for (std::size_t i = 0; i < count; ++i) usable[first + i] = sum[i] == 0 ? 1 : 0;
  }
}

template <class Map>
void quantize_channels(const GaussiansView& in, const AttributeChannels& a, QuantizedGaussians& out, Map map) {
  const coding::Step step = step_of(a);
  for (int c = 0; c < a.channels; ++c) {
    const float* from = in.plane(parameter_channel(a.attribute) + c);
    std::int32_t* to = out.channels[a.first + c].data();
    for (std::size_t i = 0; i < in.count; ++i) to[i] = step(map(from[i]));
  }
}

}  // namespace

coding::Step step_of(const AttributeChannels& a) {
  return {.offset = a.quantizer.offset,
          .per_step = 1 / a.quantizer.step,
          .minimum = static_cast<float>(a.minimum),
          .maximum = static_cast<float>(a.maximum)};
}

QuantizedGaussians::QuantizedGaussians(const StreamLayout& layout, std::size_t count) : channels(layout.channels()) {
  resize(count);
}

void QuantizedGaussians::resize(std::size_t count) {
  for (auto& plane : channels) plane.resize(count);
  object_id.resize(count);
  gaussian_id.resize(count);
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

void quantize(const GaussiansView& gaussians, const StreamLayout& layout, QuantizedGaussians& out,
              std::vector<std::uint8_t>& usable, const QuantizedGaussians* held, const std::uint32_t* held_column) {
  assert(layout.carries(gaussians.layout));
  const std::size_t count = gaussians.count;
  out.channels.resize(static_cast<std::size_t>(layout.channels()));
  out.resize(count);
  find_unusable(gaussians, usable);
  for (const AttributeChannels& a : layout.attributes()) {
    switch (a.attribute) {
      case Attribute::Rotation:
        quantise_rotation(gaussians, layout, out, held, held_column);
        break;
      case Attribute::Normal:
        quantise_normal(gaussians, a, out);
        break;
      case Attribute::Opacity:
        quantize_channels(gaussians, a, out, coding::sigmoid);
        break;
      case Attribute::Albedo:
        quantize_channels(gaussians, a, out, coding::srgb_odd);
        break;
      case Attribute::Visibility: {
        const coding::Step step = step_of(a);
        for (std::size_t i = 0; i < count; ++i) {
          out.channels[a.first][i] = step(gaussians.visibility ? gaussians.visibility[i] : 1.0F);
        }
        break;
      }
      default:
        quantize_channels(gaussians, a, out, [](float value) { return value; });
    }
  }
  for (std::size_t i = 0; i < count; ++i) {
    out.object_id[i] = gaussians.object_id ? gaussians.object_id[i] : 0;
    out.gaussian_id[i] = gaussians.gaussian_id ? gaussians.gaussian_id[i] : 0;
    if (usable[i]) continue;
    for (auto& plane : out.channels) plane[i] = 0;
  }
}

void dequantize(const QuantizedGaussians& gaussians, const StreamLayout& layout, Attribute attribute,
                std::span<const std::uint32_t> columns, const DequantizedChannels& out) {
  const AttributeChannels& a = layout.at(attribute);
  const auto value = [&](int channel, std::uint32_t column) {
    return a.quantizer.offset + a.quantizer.step * static_cast<float>(gaussians.channels[a.first + channel][column]);
  };
  const auto plane = [&](int channel) { return out.parameters + static_cast<std::size_t>(channel) * out.stride; };
  const int first = parameter_channel(attribute);
  switch (attribute) {
    case Attribute::Rotation:
      for (const std::uint32_t i : columns) {
        const coding::Quaternion q = coding::from_rotation_vector({value(0, i), value(1, i), value(2, i)});
        plane(first)[i] = q.w;
        plane(first + 1)[i] = q.x;
        plane(first + 2)[i] = q.y;
        plane(first + 3)[i] = q.z;
      }
      return;
    case Attribute::Opacity:
      for (const std::uint32_t i : columns) {
        const float opacity = std::clamp(value(0, i), 0.0005F, 0.9995F);
        plane(first)[i] = std::log(opacity / (1 - opacity));
      }
      return;
    case Attribute::Normal:
      for (const std::uint32_t i : columns) {
        const glm::vec3 n = from_octahedral({value(0, i), value(1, i)});
        for (int c = 0; c < 3; ++c) out.normal[c * out.stride + i] = n[c];
      }
      return;
    case Attribute::Visibility:
      for (const std::uint32_t i : columns) out.visibility[i] = value(0, i);
      return;
    default:
      break;
  }
  const bool albedo = attribute == Attribute::Albedo;
  for (int c = 0; c < a.channels; ++c) {
    float* to = plane(first + c);
    for (const std::uint32_t i : columns) to[i] = albedo ? linear_odd(value(c, i)) : value(c, i);
  }
}

}  // namespace splatbus::stream
