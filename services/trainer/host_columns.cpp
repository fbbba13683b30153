#include "trainer/host_columns.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <glm/glm.hpp>
#include <numbers>
#include <numeric>

#include "bus/memory.h"
#include "gaussians/sh.h"

namespace splatbus::trainer {

namespace {

/// What a row starts with in Radiance: constant band of the lit colour, display space (Kerbl et al. 2023).
glm::vec3 radiance_dc(const InsertBatch& batch, const InsertRows& rows, std::size_t row) {
  const auto vec = [&](const float* planes) {
    return glm::vec3(planes[row], planes[rows.stride + row], planes[2 * rows.stride + row]);
  };
  const auto object = batch.objects.find(rows.object_id[row]);
  const glm::vec3 normal =
      object == batch.objects.end() ? vec(rows.normal) : object->second.rotation * vec(rows.normal);
  const float cosine = std::max(0.0F, glm::dot(normal, batch.light.sun_direction));
  const glm::vec3 direct = batch.light.sun_irradiance * (rows.visibility[row] * cosine / std::numbers::pi_v<float>);
  const glm::vec3 lit = vec(rows.albedo) * (glm::max(ambient_reflected(batch.light, normal), 0.0F) + direct);
  glm::vec3 dc{};
  for (int c = 0; c < 3; ++c) dc[c] = (srgb_from_linear(std::clamp(lit[c], 0.0F, 1.0F)) - 0.5F) / kShC0;
  return dc;
}

bool finite_column(const ModelPlanes& planes, std::size_t column) {
  const auto finite = [&](const float* plane, std::size_t channels) {
    for (std::size_t c = 0; c < channels; ++c) {
      if (!std::isfinite(plane[c * planes.capacity + column])) return false;
    }
    return true;
  };
  const auto channels = static_cast<std::size_t>(planes.layout.channels());
  return finite(planes.parameters, channels) && finite(planes.average, channels) && finite(planes.normal, 3) &&
         finite(planes.surface_point, 3) && finite(planes.visibility, 1);
}

}  // namespace

void HostColumns::append(const ModelPlanes& planes, const InsertBatch& batch, std::size_t first, std::size_t count,
                         std::uint64_t first_id) {
  assert(batch.memory() == Device::Cpu);
  const InsertRows rows = batch.rows();
  const std::size_t stride = planes.capacity;
  const auto fill = [&](float* to, int channel, const float* from, std::size_t channels) {
    for (std::size_t c = 0; c < channels; ++c) {
      std::copy_n(from + c * rows.stride, count, to + (static_cast<std::size_t>(channel) + c) * stride + first);
    }
  };
  float* const parameters = planes.parameters;
  fill(parameters, ParameterLayout::kMean, rows.mean, 3);
  fill(parameters, ParameterLayout::kLogScale, rows.log_scale, 3);
  fill(parameters, ParameterLayout::kRotation, rows.rotation, 4);
  fill(parameters, ParameterLayout::kOpacityLogit, rows.opacity_logit, 1);
  const auto channels = static_cast<std::size_t>(planes.layout.channels());
  for (std::size_t c = ParameterLayout::kAppearance; c < channels; ++c) {
    std::fill_n(parameters + c * stride + first, count, 0.0F);
  }
  if (planes.layout.appearance == Appearance::Transfer) {
    fill(parameters, ParameterLayout::kAlbedo, rows.albedo, 3);
  } else {
    for (std::size_t row = 0; row < count; ++row) {
      const glm::vec3 dc = radiance_dc(batch, rows, row);
      for (int c = 0; c < 3; ++c) {
        parameters[static_cast<std::size_t>(ParameterLayout::kAppearance + c) * stride + first + row] = dc[c];
      }
    }
  }
  for (std::size_t c = 0; c < channels; ++c) {
    std::copy_n(parameters + c * stride + first, count, planes.average + c * stride + first);
  }
  fill(planes.normal, 0, rows.normal, 3);
  fill(planes.surface_point, 0, rows.mean, 3);
  fill(planes.visibility, 0, rows.visibility, 1);
  std::copy_n(rows.object_id, count, planes.object_id + first);
  std::copy_n(rows.cell, count, planes.cell + first);
  std::fill_n(planes.flags + first, count, 0U);
  std::iota(planes.gaussian_id + first, planes.gaussian_id + first + count, first_id);
}

void HostColumns::duplicate(const ModelPlanes& planes, std::span<const std::uint32_t> columns, std::size_t first,
                            std::uint64_t first_id) {
  for (std::size_t i = 0; i < columns.size(); ++i) {
    planes.move_column(columns[i], first + i);
    planes.gaussian_id[first + i] = first_id + i;
  }
}

ColumnMoves HostColumns::remove(const ModelPlanes& planes, std::size_t count, const std::uint8_t* dead) {
  const auto new_count = static_cast<std::size_t>(std::count(dead, dead + count, std::uint8_t{0}));
  from_.clear();
  to_.clear();
  for (std::size_t i = 0; i < new_count; ++i) {
    if (dead[i] != 0) to_.push_back(static_cast<std::uint32_t>(i));
  }
  for (std::size_t i = new_count; i < count; ++i) {
    if (dead[i] == 0) from_.push_back(static_cast<std::uint32_t>(i));
  }
  for (std::size_t k = 0; k < from_.size(); ++k) planes.move_column(from_[k], to_[k]);
  return {.moved = from_.size(), .from = from_.data(), .to = to_.data(), .new_count = new_count};
}

void HostColumns::set_visibility(const ModelPlanes& planes, const float* values, Device memory, std::size_t count) {
  bus::copy_memory(planes.visibility, Device::Cpu, values, memory, count * sizeof(float));
  if (memory != Device::Cpu) bus::finish_copies();
  std::transform(planes.visibility, planes.visibility + count, planes.visibility,
                 [](float value) { return value >= 0 ? std::min(value, 1.0F) : 0.0F; });
}

ModelColumns::Inspection HostColumns::inspect(const ModelPlanes& planes, std::size_t count) {
  Inspection found{.gaussian_id = {planes.gaussian_id, planes.gaussian_id + count},
                   .broken = std::vector<std::uint8_t>(count, 0)};
  const float* const logits = planes.parameters + ParameterLayout::kOpacityLogit * planes.capacity;
  for (std::size_t i = 0; i < count; ++i) {
    found.broken[i] = logits[i] < kLeftInvisibleLogit || !finite_column(planes, i) ? 1 : 0;
  }
  return found;
}

std::vector<std::uint32_t> kept_columns(const ColumnMoves& moves) {
  std::vector<std::uint32_t> keep(moves.new_count);
  std::iota(keep.begin(), keep.end(), 0U);
  for (std::size_t k = 0; k < moves.moved; ++k) keep[moves.to[k]] = moves.from[k];
  return keep;
}

}  // namespace splatbus::trainer
