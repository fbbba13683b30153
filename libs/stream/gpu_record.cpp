#include "stream/gpu_record.h"

#include <algorithm>
#include <cmath>
#include <glm/packing.hpp>

#include "gaussians/sh.h"

namespace splatbus::stream {

namespace {

constexpr float kMaxSharedExponent = 65408;
constexpr float kPi = 3.14159265F;

/// Half up, of what is not negative.
std::uint32_t rounded(float value) {
  const float above = value + 0.5F;
  return static_cast<std::uint32_t>(above);
}

std::int16_t steps(float value, float step) {
  return static_cast<std::int16_t>(std::lrint(std::clamp(value / step, -32767.0F, 32767.0F)));
}

AttributeChannels channels_of(const StreamLayout& layout, Attribute attribute) {
  const AttributeChannels* found = layout.find(attribute);
  return found ? *found : AttributeChannels{};
}

}  // namespace

std::uint32_t shared_exponent_rgb(const glm::vec3& color) {
  std::array<float, 3> c{};
  float largest = 0;
  for (int i = 0; i < 3; ++i) {
    const float bounded = color[i] > 0 ? std::min(color[i], kMaxSharedExponent) : 0.0F;
    c[static_cast<std::size_t>(i)] = bounded;
    largest = std::max(largest, bounded);
  }
  // Exponent e: a step is 2^(e - 24), and 2^(e - 15) is above the largest.
  int exponent = std::max(0, static_cast<int>(glm::floatBitsToUint(largest) >> 23) - 127 + 16);
  const auto per_step = [](int e) { return glm::uintBitsToFloat(static_cast<std::uint32_t>(127 + 24 - e) << 23); };
  if (std::floor(largest * per_step(exponent) + 0.5F) >= 512) ++exponent;
  std::uint32_t out = static_cast<std::uint32_t>(exponent) << 27;
  for (std::size_t i = 0; i < 3; ++i) out |= rounded(c[i] * per_step(exponent)) << (9 * i);
  return out;
}

std::size_t harmonic_words(const StreamLayout& layout) {
  const AttributeChannels* rest = layout.find(Attribute::ShRest);
  return rest ? (static_cast<std::size_t>(3 + rest->channels) + 7) / 8 * 4 : 0;
}

RecordMaker::RecordMaker(const HeldGaussians& gaussians, const StreamLayout& layout)
    : gaussians_(gaussians),
      transfer_(layout.parameters().appearance == Appearance::Transfer),
      mean_(layout.at(Attribute::Mean)),
      log_scale_(layout.at(Attribute::LogScale)),
      rotation_(layout.at(Attribute::Rotation)),
      opacity_(layout.at(Attribute::Opacity)),
      color_(layout.at(transfer_ ? Attribute::Albedo : Attribute::ShDc)),
      residual_(channels_of(layout, Attribute::Residual)),
      normal_(channels_of(layout, Attribute::Normal)),
      visibility_(channels_of(layout, Attribute::Visibility)),
      rest_(channels_of(layout, Attribute::ShRest)) {
  const Quantizer& q = color_.quantizer;
  for (std::size_t k = 0; transfer_ && k < kTabled; ++k) {
    albedo_[k] = coding::linear_odd(q.offset + q.step * static_cast<float>(k));
  }
}

float RecordMaker::albedo(int channel, std::size_t column) const {
  const std::int32_t q = gaussians_.channels[color_.first + channel][column];
  if (q >= 0 && q < static_cast<std::int32_t>(kTabled)) return albedo_[static_cast<std::size_t>(q)];
  return coding::linear_odd(value(color_, channel, column));
}

GpuRecord RecordMaker::record(std::size_t column, std::uint32_t object_index) const {
  GpuRecord out;
  glm::vec3 rotation = triple(rotation_, 0, column);
  // The same turn, by half of one at most.
  if (const float angle = glm::length(rotation); angle > kPi) {
    rotation *= (angle - 2 * kPi * std::round(angle / (2 * kPi))) / angle;
  }
  for (int c = 0; c < 3; ++c) {
    const auto k = static_cast<std::size_t>(c);
    out.mean[k] = value(mean_, c, column);
    out.log_scale[k] = steps(value(log_scale_, c, column), kLogScaleStep);
    out.rotation[k] = steps(rotation[c], kRotationStep_rad);
  }
  const float opacity = std::clamp(255 * value(opacity_, 0, column), 0.0F, 255.0F);
  out.opacity_object = rounded(opacity) | object_index << 8;
  return out;
}

float RecordMaker::sun_visibility(std::size_t column) const {
  return transfer_ ? value(visibility_, 0, column) : 1.0F;
}

void RecordMaker::harmonics(std::size_t column, std::span<std::uint32_t> out) const {
  std::array<float, std::size_t{3} * kMaxShCoefficients> values{};
  for (int c = 0; c < 3; ++c) values[static_cast<std::size_t>(c)] = 0.5F + kShC0 * value(color_, c, column);
  for (int c = 0; c < rest_.channels; ++c) values[3 + static_cast<std::size_t>(c)] = value(rest_, c, column);
  for (std::size_t k = 0; k < out.size(); ++k) out[k] = glm::packHalf2x16({values[2 * k], values[2 * k + 1]});
}

std::uint32_t RecordMaker::color(std::size_t column, std::span<const float> visibility,
                                 const Light& light_object) const {
  if (!transfer_) return shared_exponent_rgb(0.5F + kShC0 * triple(color_, 0, column));
  const coding::Vector normal = coding::from_octahedral({value(normal_, 0, column), value(normal_, 1, column)});
  TransferValues values{
      .mean = triple(mean_, 0, column), .normal = {normal.x, normal.y, normal.z}, .albedo = {}, .residual = {}};
  for (int c = 0; c < 3; ++c) values.albedo[c] = albedo(c, column);
  for (int k = 0; k < 9; ++k) values.residual[static_cast<std::size_t>(k)] = triple(residual_, 3 * k, column);
  return shared_exponent_rgb(shade_transfer(values, visibility, light_object));
}

}  // namespace splatbus::stream
