#pragma once

#include <tbb/parallel_for.h>

#include <cstdint>
#include <glm/glm.hpp>
#include <vector>

#include "sim/random.h"
#include "sim/scene.h"

namespace splatbus::sim {

/// Writes the three sRGB bytes of a linear color.
void encode_srgb(const glm::vec3& linear, std::uint8_t* bytes);

[[nodiscard]] inline float hash01(std::uint32_t seed, int x, int y) {
  return random01(seed, static_cast<std::uint32_t>(x), static_cast<std::uint32_t>(y));
}

/// Value noise in [0, 1) that repeats every `period` cells.
[[nodiscard]] float noise(std::uint32_t seed, glm::vec2 p, glm::ivec2 period);

/// Samples `color_at`(u, v), linear RGB, 2 x 2 times a texel; on several threads.
template <class ColorAt>
Image paint(std::uint32_t side, const ColorAt& color_at) {
  Image image{.width = side, .height = side, .rgba = std::vector<std::uint8_t>(std::size_t{4} * side * side, 255)};
  tbb::parallel_for(std::uint32_t{0}, side, [&](std::uint32_t y) {
    std::uint8_t* texel = image.rgba.data() + std::size_t{4} * side * y;
    for (std::uint32_t x = 0; x < side; ++x, texel += 4) {
      glm::vec3 sum{0};
      for (const glm::vec2 offset : {glm::vec2{0.25F, 0.25F}, {0.75F, 0.25F}, {0.25F, 0.75F}, {0.75F, 0.75F}}) {
        sum += color_at((static_cast<float>(x) + offset.x) / static_cast<float>(side),
                        (static_cast<float>(y) + offset.y) / static_cast<float>(side));
      }
      encode_srgb(sum / 4.0F, texel);
    }
  });
  return image;
}

}  // namespace splatbus::sim
