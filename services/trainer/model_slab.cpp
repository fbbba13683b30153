#include "trainer/model_slab.h"

#include <algorithm>

#include "bus/memory.h"

namespace splatbus::trainer {

namespace {

template <class T>
void move_planes(T* planes, std::size_t channels, std::size_t stride, std::size_t from, std::size_t to) {
  for (std::size_t c = 0; c < channels; ++c) planes[c * stride + to] = planes[c * stride + from];
}

}  // namespace

std::size_t rounded_capacity(std::size_t capacity) {
  return std::max<std::size_t>(16, (capacity + 15) / 16 * 16);
}

SlabLayout::SlabLayout(const ParameterLayout& layout, std::size_t capacity) {
  const auto channels = static_cast<std::size_t>(layout.channels());
  std::size_t next = 0;
  const auto reserve = [&](std::size_t plane_count, std::size_t element_bytes) {
    const std::size_t offset = next;
    next += plane_count * capacity * element_bytes;
    return offset;
  };
  parameters = reserve(channels, sizeof(float));
  average = reserve(channels, sizeof(float));
  normal = reserve(3, sizeof(float));
  surface_point = reserve(3, sizeof(float));
  visibility = reserve(1, sizeof(float));
  object_id = reserve(1, sizeof(std::uint32_t));
  flags = reserve(1, sizeof(std::uint32_t));
  cell = reserve(1, sizeof(std::uint64_t));
  gaussian_id = reserve(1, sizeof(std::uint64_t));
  bytes = next;
}

ModelPlanes::ModelPlanes(const ParameterLayout& model_layout, std::size_t columns, std::byte* slot)
    : layout(model_layout), capacity(columns) {
  const SlabLayout at(layout, capacity);
  const auto floats = [&](std::size_t offset) { return reinterpret_cast<float*>(slot + offset); };
  parameters = floats(at.parameters);
  average = floats(at.average);
  normal = floats(at.normal);
  surface_point = floats(at.surface_point);
  visibility = floats(at.visibility);
  object_id = reinterpret_cast<std::uint32_t*>(slot + at.object_id);
  flags = reinterpret_cast<std::uint32_t*>(slot + at.flags);
  cell = reinterpret_cast<std::uint64_t*>(slot + at.cell);
  gaussian_id = reinterpret_cast<std::uint64_t*>(slot + at.gaussian_id);
}

GaussiansView ModelPlanes::view(std::size_t count) const {
  return {.layout = layout,
          .count = count,
          .stride = capacity,
          .parameters = parameters,
          .normal = normal,
          .surface_point = surface_point,
          .visibility = visibility,
          .object_id = object_id,
          .flags = flags,
          .gaussian_id = gaussian_id,
          .cell = cell};
}

void ModelPlanes::move_column(std::size_t from, std::size_t to) const {
  const auto channels = static_cast<std::size_t>(layout.channels());
  float* const logits = parameters + ParameterLayout::kOpacityLogit * capacity;
  const float logit = logits[from];
  logits[to] = kInvisibleLogit;
  std::atomic_signal_fence(std::memory_order_seq_cst);
  move_planes(parameters, ParameterLayout::kOpacityLogit, capacity, from, to);
  move_planes(parameters + ParameterLayout::kAppearance * capacity, channels - ParameterLayout::kAppearance, capacity,
              from, to);
  move_planes(average, channels, capacity, from, to);
  move_planes(normal, 3, capacity, from, to);
  move_planes(surface_point, 3, capacity, from, to);
  visibility[to] = visibility[from];
  object_id[to] = object_id[from];
  flags[to] = flags[from];
  cell[to] = cell[from];
  std::atomic_signal_fence(std::memory_order_seq_cst);
  gaussian_id[to] = gaussian_id[from];
  std::atomic_signal_fence(std::memory_order_seq_cst);
  logits[to] = logit;
}

void copy_columns(const ModelPlanes& to, Device to_memory, const ModelPlanes& from, Device from_memory,
                  std::size_t count) {
  const auto copy = [&](auto* to_planes, const auto* from_planes, std::size_t channels) {
    for (std::size_t c = 0; c < channels; ++c) {
      bus::copy_memory(to_planes + c * to.capacity, to_memory, from_planes + c * from.capacity, from_memory,
                       count * sizeof(*from_planes));
    }
  };
  const auto channels = static_cast<std::size_t>(to.layout.channels());
  copy(to.parameters, from.parameters, channels);
  copy(to.average, from.average, channels);
  copy(to.normal, from.normal, 3);
  copy(to.surface_point, from.surface_point, 3);
  copy(to.visibility, from.visibility, 1);
  copy(to.object_id, from.object_id, 1);
  copy(to.flags, from.flags, 1);
  copy(to.cell, from.cell, 1);
  copy(to.gaussian_id, from.gaussian_id, 1);
  bus::finish_copies();
}

}  // namespace splatbus::trainer
