#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <type_traits>
#include <vector>

#include "bus/memory.h"
#include "bus/tensor_ring.h"
#include "device/stream.h"
#include "trainer/insert_reader.h"

namespace splatbus::trainer {

inline bool has_device(Device device) {
  try {
    static_cast<void>(device::Stream(device));
    return true;
  } catch (const std::runtime_error&) {
    return false;
  }
}

template <class T>
std::vector<T> to_host(Device device, const T* from, std::size_t count) {
  std::vector<T> values(count);
  bus::copy_memory(values.data(), Device::Cpu, from, device, count * sizeof(T));
  bus::finish_copies();
  return values;
}

/// Rows of a batch in host memory, planes [channels][count].
struct SampleBatch {
  std::uint64_t epoch = 0, batch = 0;
  std::size_t count = 0;
  std::vector<float> mean, log_scale, rotation, opacity_logit, albedo, normal, visibility;
  std::vector<std::uint32_t> object_id;
  SceneState scene;

  /// The same on a device, not checked.
  [[nodiscard]] InsertBatch on(Device device) const {
    const auto memory = bus::allocate_memory(device, std::max<std::size_t>(1, insert_rows_bytes(count)));
    std::byte* to = memory.get();
    for_each_plane(*this, [&](const char* /*name*/, const auto& plane, std::size_t /*channels*/) {
      const std::size_t bytes = plane.size() * sizeof(plane[0]);
      bus::copy_memory(to, device, plane.data(), Device::Cpu, bytes);
      to += bytes;
    });
    bus::finish_copies();
    return {.epoch = epoch,
            .batch = batch,
            .count = count,
            .memory = memory,
            .rows = insert_rows_at(memory.get(), count),
            .scene = scene};
  }

  /// The rows of a batch on a device.
  static SampleBatch of(const InsertBatch& batch, Device device) {
    SampleBatch sample{.epoch = batch.epoch, .batch = batch.batch, .count = batch.count};
    const auto take = [&](auto& to, const auto* planes, std::size_t channels) {
      for (std::size_t c = 0; c < channels; ++c) {
        const auto plane = to_host(device, planes + c * batch.rows.stride, batch.count);
        to.insert(to.end(), plane.begin(), plane.end());
      }
    };
    take(sample.mean, batch.rows.mean, 3);
    take(sample.log_scale, batch.rows.log_scale, 3);
    take(sample.rotation, batch.rows.rotation, 4);
    take(sample.opacity_logit, batch.rows.opacity_logit, 1);
    take(sample.albedo, batch.rows.albedo, 3);
    take(sample.normal, batch.rows.normal, 3);
    take(sample.visibility, batch.rows.visibility, 1);
    take(sample.object_id, batch.rows.object_id, 1);
    return sample;
  }

  /// The tensors of a model/insert message with these rows.
  [[nodiscard]] std::vector<bus::TensorSource> tensors() const {
    std::vector<bus::TensorSource> sources;
    for_each_plane(*this, [&]<class T>(const char* name, const std::vector<T>& planes, std::uint32_t channels) {
      std::vector<std::uint32_t> shape{static_cast<std::uint32_t>(count)};
      if (std::is_floating_point_v<T>) shape.insert(shape.begin(), channels);
      sources.push_back({.name = name, .shape = shape, .type = bus::ElementTypeOf<T>::value, .data = planes.data()});
    });
    return sources;
  }
};

/// Valid Gaussians scattered over a 4 m square of floor, flat.
inline SampleBatch sample_batch(std::uint64_t epoch, std::uint64_t batch_id, std::size_t count, unsigned seed = 1) {
  SampleBatch batch;
  batch.epoch = epoch;
  batch.batch = batch_id;
  batch.count = count;
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> unit(0.0F, 1.0F);
  const auto plane = [&](std::size_t channels, auto value) {
    std::vector<float> values(channels * count);
    for (std::size_t c = 0; c < channels; ++c) {
      for (std::size_t i = 0; i < count; ++i) values[c * count + i] = value(c);
    }
    return values;
  };
  batch.mean = plane(3, [&](std::size_t c) { return c == 1 ? 0.1F * unit(random) : 4.0F * unit(random) - 2.0F; });
  batch.log_scale = plane(3, [&](std::size_t c) { return std::log(c == 1 ? 0.02F : 0.1F); });
  batch.rotation = plane(4, [](std::size_t c) { return c == 0 ? 1.0F : 0.0F; });
  batch.opacity_logit = plane(1, [](std::size_t) { return 2.0F; });
  batch.albedo = plane(3, [&](std::size_t) { return 0.1F + 0.8F * unit(random); });
  batch.normal = plane(3, [](std::size_t c) { return c == 1 ? 1.0F : 0.0F; });
  batch.visibility = plane(1, [](std::size_t) { return 1.0F; });
  batch.object_id.assign(count, 0);
  batch.scene.light.sun_irradiance = glm::vec3(2.0F);
  batch.scene.light.ambient_sh[0] = glm::vec3(1.0F);
  return batch;
}

}  // namespace splatbus::trainer
