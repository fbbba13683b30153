#include "sim/paint.h"

#include <cmath>
#include <vector>

namespace splatbus::sim {

std::uint8_t encode_srgb(float linear) {
  constexpr std::size_t kEntries = 8192;  // fine enough for every byte
  static const std::vector<std::uint8_t> table = [] {
    std::vector<std::uint8_t> bytes;
    for (std::size_t i = 0; i <= kEntries; ++i) {
      const float c = static_cast<float>(i) / kEntries;
      const float s = c <= 0.0031308F ? 12.92F * c : 1.055F * std::pow(c, 1 / 2.4F) - 0.055F;
      bytes.push_back(static_cast<std::uint8_t>(std::lround(255 * s)));
    }
    return bytes;
  }();
  // NOLINTNEXTLINE(bugprone-incorrect-roundings): not negative, and an entry off by one at a half does not show
  return table[static_cast<std::size_t>(glm::clamp(linear, 0.0F, 1.0F) * kEntries + 0.5F)];
}

float noise(std::uint32_t seed, glm::vec2 p, glm::ivec2 period) {
  const glm::vec2 cell = glm::floor(p);
  glm::vec2 t = p - cell;
  t = t * t * (3.0F - 2.0F * t);
  const auto at = [&](int dx, int dy) {
    const int x = (static_cast<int>(cell.x) + dx) % period.x;
    const int y = (static_cast<int>(cell.y) + dy) % period.y;
    return hash01(seed, x < 0 ? x + period.x : x, y < 0 ? y + period.y : y);
  };
  return glm::mix(glm::mix(at(0, 0), at(1, 0), t.x), glm::mix(at(0, 1), at(1, 1), t.x), t.y);
}

}  // namespace splatbus::sim
