#include "sim/paint.h"

#include <array>
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

/// std::floor for values that fit an int; on baseline processors that is a library call.
int floored(float value) {
  const int whole = static_cast<int>(value);
  return static_cast<float>(whole) > value ? whole - 1 : whole;
}

/// The values at the corners of a cell. Pictures are painted texel by texel, and most cells hold many.
struct Corners {
  std::uint32_t seed = 0;
  glm::ivec2 cell{0}, period{0};
  float left_top = 0, right_top = 0, left_bottom = 0, right_bottom = 0;
};

const Corners& corners_of(std::uint32_t seed, glm::ivec2 cell, glm::ivec2 period) {
  constexpr std::size_t kKept = 256;
  thread_local std::array<Corners, kKept> kept;
  const std::uint32_t mixed =
      seed * 2654435761U + static_cast<std::uint32_t>(cell.x) * 97U + static_cast<std::uint32_t>(cell.y) * 41U;
  Corners& corners = kept[(mixed ^ mixed >> 13U) % kKept];
  if (corners.seed == seed && corners.cell == cell && corners.period == period) return corners;
  const int left = wrapped(cell.x, period.x), right = left + 1 == period.x ? 0 : left + 1;
  const int top = wrapped(cell.y, period.y), bottom = top + 1 == period.y ? 0 : top + 1;
  return corners = {.seed = seed,
                    .cell = cell,
                    .period = period,
                    .left_top = hash01(seed, left, top),
                    .right_top = hash01(seed, right, top),
                    .left_bottom = hash01(seed, left, bottom),
                    .right_bottom = hash01(seed, right, bottom)};
}

}  // namespace

void encode_srgb(const glm::vec3& linear, std::uint8_t* bytes) {
  constexpr std::size_t kEntries = 8192;  // fine enough for every byte
  static const std::vector<std::uint8_t> table = [] {
    std::vector<std::uint8_t> made;
    for (std::size_t i = 0; i <= kEntries; ++i) {
      const float c = static_cast<float>(i) / kEntries;
      const float s = c <= 0.0031308F ? 12.92F * c : 1.055F * std::pow(c, 1 / 2.4F) - 0.055F;
      made.push_back(static_cast<std::uint8_t>(std::lround(255 * s)));
    }
    return made;
  }();
  const glm::vec3 entry = glm::clamp(linear, 0.0F, 1.0F) * float{kEntries} + 0.5F;
  for (int c = 0; c < 3; ++c) bytes[c] = table[static_cast<std::size_t>(entry[c])];
}

float noise(std::uint32_t seed, glm::vec2 p, glm::ivec2 period) {
  const glm::ivec2 cell{floored(p.x), floored(p.y)};
  glm::vec2 t = p - glm::vec2(cell);
  t = t * t * (3.0F - 2.0F * t);
  const Corners& corners = corners_of(seed, cell, period);
  return glm::mix(glm::mix(corners.left_top, corners.right_top, t.x),
                  glm::mix(corners.left_bottom, corners.right_bottom, t.x), t.y);
}

}  // namespace splatbus::sim
