#include "viewer/gl/file_rows.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/packing.hpp>

#include "gaussians/sh.h"

namespace splatbus::viewer::gl {
namespace {

std::int16_t steps(float value, float step) {
  return static_cast<std::int16_t>(std::lround(std::clamp(value / step, -32767.0F, 32767.0F)));
}

stream::GpuRecord record_of(const GaussiansView& gaussians, std::size_t i) {
  const auto value = [&](int channel) { return *gaussians.at(channel, i); };
  stream::GpuRecord record;
  glm::quat rotation(value(ParameterLayout::kRotation), value(ParameterLayout::kRotation + 1),
                     value(ParameterLayout::kRotation + 2), value(ParameterLayout::kRotation + 3));
  rotation = glm::length(rotation) > 0 ? glm::normalize(rotation) : glm::quat(1, 0, 0, 0);
  if (rotation.w < 0) rotation = -rotation;
  const glm::vec3 axis(rotation.x, rotation.y, rotation.z);
  const float sine = glm::length(axis);
  const glm::vec3 vector = sine > 1e-7F ? axis * (2 * std::atan2(sine, rotation.w) / sine) : 2.0F * axis;
  for (int c = 0; c < 3; ++c) {
    const auto k = static_cast<std::size_t>(c);
    record.mean[k] = value(ParameterLayout::kMean + c);
    record.log_scale[k] = steps(value(ParameterLayout::kLogScale + c), stream::kLogScaleStep);
    record.rotation[k] = steps(vector[c], stream::kRotationStep_rad);
  }
  const float opacity = 1 / (1 + std::exp(-value(ParameterLayout::kOpacityLogit)));
  record.opacity_object = static_cast<std::uint32_t>(std::lround(255 * opacity));
  glm::vec3 color;
  for (int c = 0; c < 3; ++c) color[c] = 0.5F + kShC0 * value(ParameterLayout::kAppearance + c);
  record.color = stream::shared_exponent_rgb(color);
  return record;
}

void append_harmonics(const GaussiansView& gaussians, std::size_t i, RowUpdate& out) {
  std::array<float, std::size_t{3} * kMaxShCoefficients> values{};
  const int count = 3 * gaussians.layout.sh_coefficients();
  for (int k = 0; k < count; ++k) {
    const float value = *gaussians.at(ParameterLayout::kAppearance + k, i);
    values[static_cast<std::size_t>(k)] = k < 3 ? 0.5F + kShC0 * value : value;
  }
  for (std::size_t word = 0; word < out.harmonic_words; ++word) {
    out.harmonics.push_back(glm::packHalf2x16({values[2 * word], values[2 * word + 1]}));
  }
}

}  // namespace

SharedBatch rows_of(const GaussiansView& gaussians) {
  auto batch = std::make_shared<Batch>();
  batch->whole = true;
  batch->object_ids = {kWorldFrame};
  batch->display_space = true;
  if (gaussians.layout.sh_degree > 0) {
    batch->update.harmonic_words = (3 * static_cast<std::size_t>(gaussians.layout.sh_coefficients()) + 1) / 2;
  }
  for (std::size_t i = 0; i < gaussians.count; ++i) {
    batch->update.rows.push_back(static_cast<std::uint32_t>(i));
    batch->update.records.push_back(record_of(gaussians, i));
    batch->update.fades.push_back(kNoFade);
    if (batch->update.harmonic_words > 0) append_harmonics(gaussians, i, batch->update);
  }
  return batch;
}

}  // namespace splatbus::viewer::gl
