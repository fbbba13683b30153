#pragma once

#include <cmath>
#include <cstdint>
#include <memory>
#include <vector>

#include "expander/gaussian_inserter.h"

namespace splatbus::expander::test {

constexpr float kSpacing = 0.05F;
constexpr float kCellSize_m = 0.25F;

/// A round in host memory of the test's own.
struct HostRound : RoundInfo {
  std::vector<glm::vec3> position, normal, albedo, color;
  std::vector<float> spacing_m;
  std::vector<std::uint32_t> object_id;

  [[nodiscard]] std::size_t size() const { return position.size(); }
  void resize(std::size_t count) {
    for (auto* vectors : {&position, &normal, &albedo, &color}) vectors->resize(count);
    spacing_m.resize(count);
    object_id.resize(count);
  }
};

/// As if it had come in a message.
inline IncomingRound incoming(const HostRound& round) {
  const auto kept = std::make_shared<const HostRound>(round);
  IncomingRound sent;
  static_cast<RoundInfo&>(sent) = round;
  sent.count = static_cast<std::uint32_t>(round.size());
  const auto add = [&](const auto& values, std::vector<std::uint32_t> shape, bus::ElementType type) {
    sent.tensors.emplace_back("tensor", std::move(shape), type, reinterpret_cast<const std::byte*>(values.data()),
                              values.size() * sizeof(values[0]), kept);
  };
  for (const auto* vectors : {&kept->position, &kept->normal, &kept->albedo, &kept->color}) {
    add(*vectors, {sent.count, 3}, bus::ElementType::F32);
  }
  add(kept->spacing_m, {sent.count}, bus::ElementType::F32);
  add(kept->object_id, {sent.count}, bus::ElementType::U32);
  return sent;
}

/// Gaussians in host memory, in the order of their batches.
struct HostGaussians {
  std::vector<glm::vec3> mean, log_scale, albedo, normal;
  std::vector<glm::quat> rotation;
  std::vector<float> opacity_logit, visibility;
  std::vector<std::uint32_t> object_id;
  [[nodiscard]] std::size_t size() const { return mean.size(); }

  void append(const InsertBatch& batch) {
    const std::uint32_t n = batch.count;
    std::vector<std::byte> bytes(batch.bytes());
    const device::StreamView stream = device::thread_stream(batch.memory);
    device::copy(stream, bytes.data(), batch.data.get(), bytes.size());
    stream.wait();
    const InsertChannels from = insert_channels_at(bytes.data(), n);
    for (std::uint32_t i = 0; i < n; ++i) {
      const auto at = [&](const float* channel) { return glm::vec3(channel[i], channel[n + i], channel[2 * n + i]); };
      mean.push_back(at(from.mean));
      log_scale.push_back(at(from.log_scale));
      albedo.push_back(at(from.albedo));
      normal.push_back(at(from.normal));
      rotation.emplace_back(from.rotation[i], from.rotation[n + i], from.rotation[2 * n + i], from.rotation[3 * n + i]);
      opacity_logit.push_back(from.opacity_logit[i]);
      visibility.push_back(from.visibility[i]);
      object_id.push_back(from.object_id[i]);
    }
  }
};

inline HostGaussians on_host(const std::vector<InsertBatch>& batches) {
  HostGaussians all;
  for (const InsertBatch& batch : batches) all.append(batch);
  return all;
}

/// Gaussians of the world's frame at these positions, in host memory.
inline InsertBatch batch_of(const std::vector<glm::vec3>& positions, const glm::vec3& normal = {0, 1, 0}) {
  InsertBatch batch = allocate_batch({}, static_cast<std::uint32_t>(positions.size()));
  const std::size_t n = positions.size();
  std::fill_n(batch.data.get(), batch.bytes(), std::byte{0});
  const InsertChannels channels = batch.channels();
  for (std::size_t i = 0; i < n; ++i) {
    const glm::vec3& p = positions[i];
    for (int c = 0; c < 3; ++c) {
      channels.mean[static_cast<std::size_t>(c) * n + i] = p[c];
      channels.normal[static_cast<std::size_t>(c) * n + i] = normal[c];
    }
  }
  return batch;
}

/// Seen from 3 m above the origin.
inline HostRound empty_round() {
  HostRound round;
  round.rig_generation = 1;
  round.cameras = {look_at({0, 3, 0.001F}, {0, 0, 0}, 64, 64, 1.2F)};
  round.scene.light.sun_direction = {0, 1, 0};
  round.scene.light.sun_irradiance = {2, 2, 2};
  return round;
}

inline void add_sample(HostRound& round, const glm::vec3& position, std::uint32_t object_id = 1,
                       const glm::vec3& normal = {0, 1, 0}) {
  round.position.push_back(position);
  round.normal.push_back(normal);
  round.albedo.emplace_back(0.5F, 0.4F, 0.3F);
  round.color.emplace_back(0.3F, 0.3F, 0.3F);
  round.spacing_m.push_back(kSpacing);
  round.object_id.push_back(object_id);
}

/// A square grid of samples of the floor over [low, high) in x and z, shifted by `shift` of a step.
inline void add_floor(HostRound& round, float low, float high, float shift = 0.5F) {
  const auto steps = static_cast<int>(std::lround((high - low) / kSpacing));
  for (int x = 0; x < steps; ++x) {
    for (int z = 0; z < steps; ++z) {
      add_sample(round, {low + (static_cast<float>(x) + shift) * kSpacing, 0,
                         low + (static_cast<float>(z) + shift) * kSpacing});
    }
  }
}

inline HostRound floor_round(float low, float high, float shift = 0.5F) {
  HostRound round = empty_round();
  add_floor(round, low, high, shift);
  return round;
}

}  // namespace splatbus::expander::test
