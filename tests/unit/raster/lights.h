#pragma once

#include <cstdint>
#include <random>
#include <vector>

#include "gaussians/light.h"

namespace splatbus::raster::testing {

/// Lights of every kind besides the sun: a directional one, a point light amid the Gaussians, a spot whose cone holds
/// some of them, and a point light that only the nearest see.
inline void add_sources(Light& light) {
  light.sources = {{.id = 2,
                    .kind = LightKind::Directional,
                    .direction = glm::normalize(glm::vec3(-0.5F, 0.3F, 0.8F)),
                    .intensity = {0.9F, 0.4F, 1.5F}},
                   {.id = 5,
                    .kind = LightKind::Point,
                    .position = {0.2F, 0.3F, 0.9F},
                    .intensity = {1.5F, 2.5F, 0.7F},
                    .range_m = 4},
                   {.id = 6,
                    .kind = LightKind::Spot,
                    .position = {-0.8F, 1.5F, 1.2F},
                    .direction = glm::normalize(glm::vec3(0.5F, -0.9F, -0.7F)),
                    .intensity = {9, 7, 12},
                    .range_m = 5,
                    .cos_inner = 0.97F,
                    .cos_outer = 0.8F},
                   {.id = 9,
                    .kind = LightKind::Point,
                    .casts_shadow = false,
                    .position = {0.5F, -0.4F, 0.1F},
                    .intensity = {0.5F, 0.2F, 0.9F},
                    .range_m = 0.6F}};
}

/// The same on every machine.
inline std::vector<std::uint8_t> random_bytes(std::size_t count, std::uint32_t seed) {
  std::mt19937 generator(seed);
  std::vector<std::uint8_t> bytes(count);
  for (std::uint8_t& value : bytes) value = static_cast<std::uint8_t>(generator() >> 24U);
  return bytes;
}

}  // namespace splatbus::raster::testing
