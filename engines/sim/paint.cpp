#include "sim/paint.h"

#include <cmath>
#include <vector>

namespace splatbus::sim {

namespace {

// A division takes longer than all else that noise() does, and hardly any cell needs one.
int wrapped(int cell, int period) {
  if (cell >= 0 && cell < period) return cell;
  const int rest = cell % period;
  return rest < 0 ? rest + period : rest;
}

}  // namespace

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
  const int left = wrapped(static_cast<int>(cell.x), period.x), right = left + 1 == period.x ? 0 : left + 1;
  const int top = wrapped(static_cast<int>(cell.y), period.y), bottom = top + 1 == period.y ? 0 : top + 1;
  return glm::mix(glm::mix(hash01(seed, left, top), hash01(seed, right, top), t.x),
                  glm::mix(hash01(seed, left, bottom), hash01(seed, right, bottom), t.x), t.y);
}

}  // namespace splatbus::sim
