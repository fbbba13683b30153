#include "sim/mipmaps.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>

#include "sim/paint.h"

namespace splatbus::sim {

namespace {

// IEC 61966-2-1.
const std::array<float, 256>& linear_of_srgb() {
  static const std::array<float, 256> table = [] {
    std::array<float, 256> linear{};
    for (std::size_t byte = 0; byte < linear.size(); ++byte) {
      const float s = static_cast<float>(byte) / 255;
      linear.at(byte) = s <= 0.04045F ? s / 12.92F : std::pow((s + 0.055F) / 1.055F, 2.4F);
    }
    return linear;
  }();
  return table;
}

Image halved(const Image& image) {
  Image half{.width = std::max(image.width / 2, 1U), .height = std::max(image.height / 2, 1U), .rgba = {}};
  half.rgba.resize(std::size_t{4} * half.width * half.height);
  const std::array<float, 256>& linear = linear_of_srgb();
  tbb::parallel_for(std::uint32_t{0}, half.height, [&](std::uint32_t y) {
    const std::size_t row_bytes = std::size_t{4} * image.width;
    const std::uint8_t* upper = image.rgba.data() + row_bytes * std::min(2 * y, image.height - 1);
    const std::uint8_t* lower = image.rgba.data() + row_bytes * std::min(2 * y + 1, image.height - 1);
    std::uint8_t* texel = half.rgba.data() + std::size_t{4} * half.width * y;
    for (std::uint32_t x = 0; x < half.width; ++x, texel += 4) {
      const std::size_t left = std::size_t{4} * std::min(2 * x, image.width - 1);
      const std::size_t right = std::size_t{4} * std::min(2 * x + 1, image.width - 1);
      const std::array four{upper + left, upper + right, lower + left, lower + right};
      glm::vec3 sum{0};
      std::uint32_t alpha = 2;  // rounds
      for (const std::uint8_t* of_four : four) {
        sum += glm::vec3{linear[of_four[0]], linear[of_four[1]], linear[of_four[2]]};
        alpha += of_four[3];
      }
      encode_srgb(sum / 4.0F, texel);
      texel[3] = static_cast<std::uint8_t>(alpha / 4);
    }
  });
  return half;
}

}  // namespace

bool has_whole_mipmaps(const Image& image) {
  return std::has_single_bit(image.width) && std::has_single_bit(image.height);
}

std::vector<Image> mipmaps(const Image& image) {
  std::vector<Image> levels;
  const Image* last = &image;
  levels.reserve(32);
  while (last->width > 1 || last->height > 1) last = &levels.emplace_back(halved(*last));
  return levels;
}

}  // namespace splatbus::sim
