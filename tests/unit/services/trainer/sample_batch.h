#pragma once

#include <cmath>
#include <random>

#include "trainer/insert_batch.h"

namespace splatbus::trainer {

/// Valid Gaussians scattered over a 4 m square of floor, flat, in cells of one metre.
inline InsertBatch sample_batch(std::uint64_t epoch, std::uint64_t batch_id, std::size_t count, unsigned seed = 1) {
  InsertBatch batch;
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
  for (std::size_t i = 0; i < count; ++i) {
    batch.cell.push_back(static_cast<std::uint64_t>(std::floor(batch.mean[i]) + 2.0F));
  }
  batch.light.sun_irradiance = glm::vec3(2.0F);
  batch.light.ambient_sh[0] = glm::vec3(1.0F);
  return batch;
}

}  // namespace splatbus::trainer
