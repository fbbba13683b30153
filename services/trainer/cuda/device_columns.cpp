#include "trainer/cuda/device_columns.h"

#include <algorithm>
#include <glm/glm.hpp>
#include <vector>

#include "bus/memory.h"

namespace splatbus::trainer::cuda {

namespace {

InsertLight insert_light(const Light& light) {
  InsertLight result{};
  for (int c = 0; c < 3; ++c) {
    for (std::size_t k = 0; k < light.ambient_sh.size(); ++k) {
      result.ambient_sh[3 * k + static_cast<std::size_t>(c)] = light.ambient_sh[k][c];
    }
    result.sun_direction[c] = light.sun_direction[c];
    result.sun_irradiance[c] = light.sun_irradiance[c];
  }
  return result;
}

std::vector<ObjectRotation> object_rotations(const ObjectTransforms& objects) {
  std::vector<ObjectRotation> rotations;
  rotations.reserve(objects.size());
  for (const auto& [id, world_from_object] : objects) {
    const glm::quat& q = world_from_object.rotation;
    rotations.push_back({.id = id, .w = q.w, .x = q.x, .y = q.y, .z = q.z});
  }
  return rotations;
}

std::uint32_t u32(std::size_t value) {
  return static_cast<std::uint32_t>(value);
}

}  // namespace

DeviceColumns::DeviceColumns() : counter_(1), host_counter_(1) {}

template <class Launch>
std::uint32_t DeviceColumns::counted(Launch&& launch) {
  counter_.clear(stream_.get());
  launch(counter_.data());
  counter_.download(host_counter_.data(), 1, stream_.get());
  stream_.wait();
  return host_counter_[0];
}

InsertRows DeviceColumns::upload(const InsertRows& rows, std::size_t count) {
  rows_.resize(insert_rows_bytes(count));
  std::byte* next = rows_.data();
  for_each_plane(rows, [&](const char* /*name*/, const auto* planes, std::size_t channels) {
    const std::size_t row_bytes = count * sizeof(*planes);
    device::check(cudaMemcpy2DAsync(next, row_bytes, planes, rows.stride * sizeof(*planes), row_bytes, channels,
                                    cudaMemcpyHostToDevice, stream_.get()),
                  "copying inserted rows to the device");
    next += channels * row_bytes;
  });
  return insert_rows_at(rows_.data(), count);
}

void DeviceColumns::append(const ModelPlanes& planes, const InsertBatch& batch, std::size_t first, std::size_t count,
                           std::uint64_t first_id) {
  if (count == 0) return;
  InsertRows rows = batch.rows();
  if (batch.memory() == Device::Cpu) rows = upload(rows, count);
  const std::vector<ObjectRotation> objects = object_rotations(batch.objects);
  objects_.upload(objects.data(), objects.size(), stream_.get());
  launch_append(planes, rows, u32(first), u32(count), first_id, insert_light(batch.light), objects_.data(),
                u32(objects.size()), stream_.get());
  stream_.wait();
}

void DeviceColumns::duplicate(const ModelPlanes& planes, std::span<const std::uint32_t> columns, std::size_t first,
                              std::uint64_t first_id) {
  if (columns.empty()) return;
  std::vector<std::uint32_t> to(columns.size());
  for (std::size_t i = 0; i < to.size(); ++i) to[i] = u32(first + i);
  from_.upload(columns.data(), columns.size(), stream_.get());
  to_.upload(to.data(), to.size(), stream_.get());
  launch_copy_columns(planes, from_.data(), to_.data(), u32(columns.size()), kInvisibleLogit, stream_.get());
  launch_number_columns(planes, u32(first), u32(columns.size()), first_id, stream_.get());
  stream_.wait();
}

ColumnMoves DeviceColumns::remove(const ModelPlanes& planes, std::size_t count, const std::uint8_t* dead) {
  const std::uint32_t removed =
      counted([&](std::uint32_t* counter) { launch_count_marks(dead, u32(count), counter, stream_.get()); });
  const std::uint32_t new_count = u32(count) - removed;
  // No more than that many columns are holes below new_count, and as many live above it.
  const std::uint32_t most = std::min(removed, new_count);
  from_.resize(std::max(most, 1U));
  to_.resize(std::max(most, 1U));
  if (most == 0) return {.moved = 0, .from = from_.data(), .to = to_.data(), .new_count = new_count};
  scratch_.resize(list_columns_scratch_bytes(u32(count)));
  const std::uint32_t moved = counted([&](std::uint32_t* counter) {
    launch_list_columns(dead, false, new_count, u32(count), from_.data(), counter, scratch_.data(), scratch_.size(),
                        stream_.get());
    launch_list_columns(dead, true, 0, new_count, to_.data(), counter, scratch_.data(), scratch_.size(), stream_.get());
  });
  launch_copy_columns(planes, from_.data(), to_.data(), moved, kInvisibleLogit, stream_.get());
  stream_.wait();
  return {.moved = moved, .from = from_.data(), .to = to_.data(), .new_count = new_count};
}

void DeviceColumns::set_visibility(const ModelPlanes& planes, const float* values, Device memory, std::size_t count) {
  if (memory == Device::Cpu) {
    values_.upload(values, count, stream_.get());
    values = values_.data();
  }
  launch_set_visibility(planes, values, u32(count), stream_.get());
  stream_.wait();
}

ModelColumns::Inspection DeviceColumns::inspect(const ModelPlanes& planes, std::size_t count) {
  Inspection found{.gaussian_id = std::vector<std::uint64_t>(count), .broken = std::vector<std::uint8_t>(count)};
  marks_.resize(std::max<std::size_t>(count, 1));
  launch_find_broken(planes, u32(count), kLeftInvisibleLogit, marks_.data(), stream_.get());
  marks_.download(found.broken.data(), count, stream_.get());
  device::check(cudaMemcpyAsync(found.gaussian_id.data(), planes.gaussian_id, count * sizeof(std::uint64_t),
                                cudaMemcpyDeviceToHost, stream_.get()),
                "copying ids to the host");
  stream_.wait();
  return found;
}

}  // namespace splatbus::trainer::cuda
