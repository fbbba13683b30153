#include "sim/world_patterns.h"

#include <algorithm>
#include <cmath>
#include <glm/gtc/constants.hpp>

#include "sim/paint.h"

namespace splatbus::sim {
namespace {

constexpr std::uint32_t kTexels = 256;

float fraction(float x) {
  return x - std::floor(x);
}

/// Fine noise about 1.
float grainy(std::uint32_t seed, float u, float v, int cells, float contrast) {
  const auto scale = static_cast<float>(cells);
  return 1 + contrast * (noise(seed, {u * scale, v * scale}, {cells, cells}) - 0.5F) +
         0.5F * contrast * (noise(seed + 1, {u * 3 * scale, v * 3 * scale}, {3 * cells, 3 * cells}) - 0.5F);
}

}  // namespace

Image brick_wall(std::uint32_t seed, int rows, float contrast) {
  return paint(2 * kTexels, [&](float u, float v) {
    const float y = v * static_cast<float>(rows);
    const int row = static_cast<int>(y);
    const float x = u * static_cast<float>(rows) / 3 + (row % 2 == 0 ? 0.0F : 0.5F);
    const int column = static_cast<int>(x) % (rows / 3);
    const float grain = grainy(seed + 3, u, v, 48, 0.25F);
    if (fraction(x) < 0.05F || fraction(y) < 0.13F) return glm::vec3(0.78F, 0.75F, 0.70F) * grain;
    const float tone = 1 - contrast * hash01(seed, column, row);
    return glm::vec3(0.9F, 0.9F - 0.1F * hash01(seed + 1, column, row), 0.86F) * tone * grain;
  });
}

Image plaster(std::uint32_t seed, float contrast) {
  return paint(kTexels, [&](float u, float v) {
    const float blotch = noise(seed + 5, {u * 5, v * 5}, {5, 5});
    return glm::vec3(0.88F * grainy(seed, u, v, 40, contrast) * (1 - 0.25F * contrast * blotch));
  });
}

Image siding(std::uint32_t seed, int boards, bool upright) {
  return paint(kTexels, [&](float u, float v) {
    const float along = upright ? v : u, across = (upright ? u : v) * static_cast<float>(boards);
    const int board = static_cast<int>(across);
    const float tone = 0.8F + 0.14F * hash01(seed, board, 1);
    const float streak = noise(seed + 2, {along * 6, across * 12}, {6, 12 * boards});
    const float within = fraction(across);
    const float relief = within < 0.07F ? 0.45F : 1 - 0.14F * within;
    return glm::vec3(tone * relief * (0.92F + 0.13F * streak));
  });
}

Image roof_tiles(std::uint32_t seed, int rows) {
  return paint(2 * kTexels, [&](float u, float v) {
    const float y = v * static_cast<float>(rows);
    const int row = static_cast<int>(y);
    const float x = u * static_cast<float>(rows) + (row % 2 == 0 ? 0.0F : 0.5F);
    const int column = static_cast<int>(x) % rows;
    const float fx = fraction(x), fy = fraction(y);
    const float round = 0.72F + 0.28F * std::sin(glm::pi<float>() * fx);
    const float lip = fy > 0.88F ? 0.55F : 1;
    const float tone = 0.68F + 0.3F * hash01(seed, column, row);
    return glm::vec3(0.95F, 0.92F, 0.9F) * round * lip * tone * grainy(seed + 4, u, v, 64, 0.2F);
  });
}

Image wallpaper(std::uint32_t seed, int kind) {
  const glm::vec3 ground(0.9F, 0.88F, 0.84F);
  const glm::vec3 ink(0.42F + 0.3F * hash01(seed, 1, 1), 0.4F + 0.3F * hash01(seed, 1, 2),
                      0.42F + 0.3F * hash01(seed, 1, 3));
  return paint(kTexels, [&](float u, float v) {
    const float x = u * 4, y = v * 4;
    const float cx = fraction(x) - 0.5F, cy = fraction(y) - 0.5F;
    const float radius = std::hypot(cx, cy), angle = std::atan2(cy, cx);
    bool inked = false;
    if (kind == 0) inked = fraction(u * 8) < 0.35F;
    if (kind == 1) inked = radius < 0.2F;
    if (kind == 2) inked = radius < 0.22F + 0.12F * std::cos(5 * angle);
    if (kind == 3) inked = std::abs(cx) + std::abs(cy) < 0.3F && std::abs(cx) + std::abs(cy) > 0.18F;
    if (kind == 4) inked = fraction(u * 12) < 0.12F || fraction(v * 12) < 0.12F;
    if (kind == 5) inked = std::abs(fraction(v * 8 + 0.12F * std::sin(u * 8 * glm::pi<float>())) - 0.5F) < 0.13F;
    if (kind == 6) inked = fraction(u * 6) < 0.1F || std::abs(fraction(u * 6) - 0.55F) < 0.04F;
    if (kind == 7) inked = std::abs(radius - 0.36F) < 0.06F || radius < 0.09F;
    return (inked ? ink : ground) * grainy(seed + 9, u, v, 64, 0.07F);
  });
}

Image floor_boards(std::uint32_t seed, int rows) {
  return paint(2 * kTexels, [&](float u, float v) {
    const float across = v * static_cast<float>(rows);
    const int row = static_cast<int>(across);
    const float along = u * 3 + 3 * hash01(seed, row, 7);
    const int piece = static_cast<int>(along) % 3;
    const float tone = 0.62F + 0.32F * hash01(seed + 5, row, piece);
    const float streak = noise(seed + 11 + static_cast<std::uint32_t>(row), {u * 8, across * 9}, {8, 9 * rows});
    const bool seam = fraction(across) < 0.05F || fraction(along) < 0.008F;
    return glm::vec3(0.92F, 0.86F, 0.78F) * tone * (0.8F + 0.3F * streak) * (seam ? 0.45F : 1.0F);
  });
}

Image floor_tiles(std::uint32_t seed, int tiles, bool checked) {
  return paint(kTexels, [&](float u, float v) {
    const float x = u * static_cast<float>(tiles), y = v * static_cast<float>(tiles);
    const int column = static_cast<int>(x), row = static_cast<int>(y);
    const float grain = grainy(seed, u, v, 32, 0.14F);
    if (fraction(x) < 0.05F || fraction(y) < 0.05F) return glm::vec3(0.5F) * grain;
    const float tone = checked && (column + row) % 2 == 0 ? 0.42F : 0.84F + 0.1F * hash01(seed, column, row);
    return glm::vec3(tone) * grain;
  });
}

Image grass(std::uint32_t seed) {
  return paint(2 * kTexels, [&](float u, float v) {
    const float patch = noise(seed, {u * 9, v * 9}, {9, 9});
    const float blades = noise(seed + 1, {u * 90, v * 60}, {90, 60}),
                other = noise(seed + 2, {u * 50, v * 110}, {50, 110});
    const float tone = 0.45F + 0.25F * patch + 0.5F * blades * other + 0.25F * blades;
    return glm::vec3(0.78F + 0.22F * patch, 1, 0.72F) * std::min(tone, 1.0F);
  });
}

Image asphalt(std::uint32_t seed) {
  return paint(2 * kTexels, [&](float u, float v) {
    const float grit = noise(seed, {u * 170, v * 170}, {170, 170}), wear = noise(seed + 1, {u * 7, v * 7}, {7, 7});
    // A crack is where a smooth noise passes its middle.
    const float crack = std::abs(noise(seed + 2, {u * 6, v * 6}, {6, 6}) - 0.5F);
    return glm::vec3((0.62F + 0.45F * (grit - 0.5F) + 0.22F * wear) * (crack < 0.006F ? 0.5F : 1));
  });
}

Image paving(std::uint32_t seed, int stones) {
  return paint(2 * kTexels, [&](float u, float v) {
    const float y = v * static_cast<float>(stones);
    const int row = static_cast<int>(y);
    const float x = u * static_cast<float>(stones) + 0.5F * static_cast<float>(row % 2);
    const int column = static_cast<int>(x) % stones;
    const float grain = grainy(seed + 2, u, v, 70, 0.22F);
    if (fraction(x) < 0.045F || fraction(y) < 0.045F) return glm::vec3(0.38F) * grain;
    return glm::vec3(0.8F, 0.78F, 0.75F) * (0.78F + 0.28F * hash01(seed, column, row)) * grain;
  });
}

Image bark(std::uint32_t seed) {
  return paint(kTexels, [&](float u, float v) {
    const float ridge = std::abs(noise(seed, {u * 14, v * 4}, {14, 4}) - 0.5F) * 2;
    return glm::vec3(0.9F, 0.85F, 0.8F) * (0.35F + 0.6F * ridge) * grainy(seed + 1, u, v, 30, 0.5F);
  });
}

Image leaves(std::uint32_t seed) {
  return paint(kTexels, [&](float u, float v) {
    // The nearest of scattered leaves, one a cell: Worley 1996.
    constexpr int kCells = 14;
    float nearest = 9, tone = 0;
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dx = -1; dx <= 1; ++dx) {
        const int x = static_cast<int>(u * kCells) + dx, y = static_cast<int>(v * kCells) + dy;
        const int wx = (x + kCells) % kCells, wy = (y + kCells) % kCells;
        const glm::vec2 middle{static_cast<float>(x) + hash01(seed, wx, wy),
                               static_cast<float>(y) + hash01(seed + 1, wx, wy)};
        const float away = glm::length(glm::vec2(u * kCells, v * kCells) - middle);
        if (away < nearest) tone = hash01(seed + 2, wx, wy);
        nearest = std::min(nearest, away);
      }
    }
    return glm::vec3(0.8F + 0.2F * tone, 1, 0.7F) * (0.5F + 0.5F * tone) * (1.1F - 0.75F * std::min(nearest, 1.0F));
  });
}

Image fabric(std::uint32_t seed, int kind) {
  return paint(kTexels, [&](float u, float v) {
    const float weave = 0.82F + 0.18F * std::sin(u * 96 * glm::pi<float>()) * std::sin(v * 96 * glm::pi<float>());
    float tone = 0.9F;
    if (kind == 1 && fraction(u * 8) < 0.4F) tone = 0.5F;
    if (kind == 2) tone = 0.9F - 0.22F * (fraction(u * 6) < 0.5F ? 1 : 0) - 0.22F * (fraction(v * 6) < 0.5F ? 1 : 0);
    if (kind == 3 && std::hypot(fraction(u * 7) - 0.5F, fraction(v * 7) - 0.5F) < 0.22F) tone = 0.55F;
    return glm::vec3(tone * weave * grainy(seed, u, v, 20, 0.12F));
  });
}

Image wood_grain(std::uint32_t seed) {
  return paint(kTexels, [&](float u, float v) {
    const float bend = noise(seed + 9, {u * 3, v * 3}, {3, 3});
    const float rings = 0.5F + 0.5F * std::sin(glm::two_pi<float>() * (v * 8 + 0.8F * bend));
    const float streak = noise(seed, {u * 5, v * 60}, {5, 60});
    return glm::vec3(0.95F, 0.9F, 0.84F) * (0.98F - 0.13F * rings - 0.22F * streak);
  });
}

Image book_spines(std::uint32_t seed) {
  return paint(2 * kTexels, [&](float u, float v) {
    constexpr int kShelves = 4, kBooks = 26;
    const float y = v * kShelves;
    const int shelf = static_cast<int>(y);
    const float x = u * kBooks + 0.35F * std::sin(9 * u * glm::two_pi<float>());
    const int book = (static_cast<int>(x) + kBooks) % kBooks;
    const auto random = [&](int use) { return hash01(seed + static_cast<std::uint32_t>(use), book, shelf); };
    const float top = 0.03F + 0.3F * random(1), fy = fraction(y);
    if (fy < top || fraction(x) < 0.07F) return glm::vec3(0.03F);
    const glm::vec3 cover = 0.08F + 0.6F * glm::vec3(random(2), random(3), random(4));
    const bool band = std::abs(fy - top - 0.12F) < 0.02F || std::abs(fy - 0.9F) < 0.015F;
    return band ? glm::vec3(0.75F, 0.66F, 0.35F) : cover;
  });
}

Image picture_atlas(std::uint32_t seed, std::uint32_t cells) {
  return paint(1024, [&](float u, float v) {
    const float x = u * static_cast<float>(cells), y = v * static_cast<float>(cells);
    const auto index = static_cast<std::uint32_t>(y) * cells + static_cast<std::uint32_t>(x);
    const glm::vec2 p{fraction(x), fraction(y)};
    const auto random = [&](std::uint32_t use) { return random01(seed, index, use); };
    const auto ink = [&](std::uint32_t use) {
      return 0.04F + 0.85F * glm::vec3(random(use), random(use + 1), random(use + 2));
    };
    const float horizon = 0.4F + 0.3F * random(1);
    switch (static_cast<int>(random(0) * 5)) {
      case 0: {  // a landscape with a sun and hills
        const float hill = horizon + 0.12F * std::sin(p.x * (4 + 7 * random(2)) + 6 * random(3));
        if (glm::distance(p, {random(4), 0.5F * horizon}) < 0.06F + 0.08F * random(5)) return ink(6);
        return p.y > hill ? glm::mix(ink(10), ink(13), (p.y - hill) / (1 - hill))
                          : glm::mix(ink(16), ink(19), p.y / hill);
      }
      case 1: {  // rings
        const float ring = glm::distance(p, {random(1), random(2)}) * (5 + 9 * random(3));
        return ink(4 + 3 * (static_cast<std::uint32_t>(ring) % 4));
      }
      case 2: {  // fields of colour
        const std::uint32_t column = p.x > 0.2F + 0.6F * random(1) ? 1 : 0, row = p.y > 0.2F + 0.6F * random(2) ? 2 : 0;
        const bool line =
            std::abs(p.x - 0.2F - 0.6F * random(1)) < 0.025F || std::abs(p.y - 0.2F - 0.6F * random(2)) < 0.025F;
        return line ? glm::vec3(0.03F) : ink(3 + 3 * (column + row));
      }
      case 3: {  // leaning stripes
        const float at = fraction((p.x * (random(1) - 0.3F) + p.y * (random(2) + 0.2F)) * (3 + 8 * random(3)));
        return at < 0.5F ? ink(4) : at < 0.8F ? ink(7) : ink(10);
      }
      default: {  // a vase of flowers
        for (std::uint32_t flower = 0; flower < 5; ++flower) {
          const glm::vec2 middle{0.2F + 0.6F * random(20 + flower), 0.15F + 0.35F * random(30 + flower)};
          const glm::vec2 to = p - middle;
          if (glm::length(to) < 0.09F + 0.03F * std::cos(6 * std::atan2(to.y, to.x))) return ink(40 + 3 * flower);
        }
        const float belly = 0.13F + 0.07F * std::sin((p.y - 0.5F) * 7);
        if (p.y > 0.58F && p.y < 0.93F && std::abs(p.x - 0.5F) < belly) return ink(60);
        return p.y > 0.85F ? ink(63) : ink(66) * (0.8F + 0.3F * p.y);
      }
    }
  });
}

Image carpet_atlas(std::uint32_t seed, std::uint32_t cells) {
  return paint(1024, [&](float u, float v) {
    const float x = u * static_cast<float>(cells), y = v * static_cast<float>(cells);
    const auto index = static_cast<std::uint32_t>(y) * cells + static_cast<std::uint32_t>(x);
    const auto random = [&](std::uint32_t use) { return random01(seed, index, use); };
    const auto ink = [&](std::uint32_t use) {
      return 0.05F + 0.6F * glm::vec3(random(use), 0.8F * random(use + 1), 0.8F * random(use + 2));
    };
    const glm::vec2 p = glm::abs(glm::vec2(fraction(x), fraction(y)) - 0.5F) * 2.0F;
    const float edge = std::max(p.x, p.y), diamond = p.x + p.y;
    if (edge > 0.94F) return ink(1);
    if (edge > 0.78F) return fraction(diamond * (4 + 5 * random(2))) < 0.5F ? ink(4) : ink(7);
    if (edge > 0.72F) return ink(1);
    const float ring = diamond * (2 + 4 * random(10)) + 0.3F * std::cos(p.x * 20 * random(11));
    return ink(13 + 3 * (static_cast<std::uint32_t>(std::max(ring, 0.0F)) % 3));
  });
}

}  // namespace splatbus::sim
