#include "sim/world_palette.h"

#include <utility>

#include "sim/world_patterns.h"

namespace splatbus::sim {

Palette::Palette(Scene& scene, std::uint32_t seed) {
  std::uint32_t next_seed = 1000 * seed;
  const auto add = [&](Surface surface, float metres, auto&& make, int count) {
    for (int i = 0; i < count; ++i) {
      scene.images.push_back(make(next_seed += 17, i));
      scene.materials.push_back({.image = static_cast<int>(scene.images.size()) - 1});
      patterns_.at(static_cast<std::size_t>(surface))
          .push_back({static_cast<int>(scene.materials.size()) - 1, 1 / metres});
    }
  };
  using Seed = std::uint32_t;
  const float kFree = 0.5F + 0.5F * random01(seed, 1, 1);  // patterns of another seed differ in more than their noise
  add(
      Surface::Brick, 1.8F,
      [&](Seed s, int i) { return brick_wall(s, 18 + 3 * (i % 3), 0.2F + 0.1F * kFree * static_cast<float>(i % 4)); },
      5);
  add(
      Surface::Plaster, 2.7F, [](Seed s, int i) { return plaster(s, 0.15F + 0.12F * static_cast<float>(i)); }, 4);
  add(
      Surface::Siding, 1.9F, [](Seed s, int i) { return siding(s, 10 + 2 * i, i % 2 == 1); }, 4);
  add(
      Surface::RoofTile, 2.6F, [](Seed s, int i) { return roof_tiles(s, 8 + 2 * (i % 4)); }, 5);
  add(
      Surface::Wallpaper, 1.3F, [](Seed s, int i) { return wallpaper(s, i % 8); }, 12);
  add(
      Surface::Boards, 1.7F, [](Seed s, int i) { return floor_boards(s, 10 + 2 * i); }, 4);
  add(
      Surface::Tiles, 1.6F, [](Seed s, int i) { return floor_tiles(s, 4 + 2 * (i / 2), i % 2 == 0); }, 4);
  add(
      Surface::Grass, 3.7F, [](Seed s, int /*i*/) { return grass(s); }, 2);
  add(
      Surface::Asphalt, 4.3F, [](Seed s, int /*i*/) { return asphalt(s); }, 2);
  add(
      Surface::Paving, 2.9F, [](Seed s, int i) { return paving(s, 6 + 2 * i); }, 2);
  add(
      Surface::Bark, 0.9F, [](Seed s, int /*i*/) { return bark(s); }, 2);
  add(
      Surface::Leaves, 1.5F, [](Seed s, int /*i*/) { return leaves(s); }, 3);
  add(
      Surface::Fabric, 0.8F, [](Seed s, int i) { return fabric(s, i % 4); }, 4);
  add(
      Surface::Wood, 1.0F, [](Seed s, int /*i*/) { return wood_grain(s); }, 3);
  add(
      Surface::Paint, 1.9F, [](Seed s, int /*i*/) { return plaster(s, 0.06F); }, 1);
  add(
      Surface::Books, 1.1F, [](Seed s, int /*i*/) { return book_spines(s); }, 2);
  add(
      Surface::Carpet, 1, [](Seed s, int /*i*/) { return carpet_atlas(s, kCarpetCells); }, 1);
  add(
      Surface::Picture, 1, [](Seed s, int /*i*/) { return picture_atlas(s, kPictureCells); }, 2);
}

Look Palette::look(Surface surface, const glm::vec3& tint, Draw& draw) const {
  const Pattern& pattern = draw.of(patterns_.at(static_cast<std::size_t>(surface)));
  // Of no two walls the pattern has quite the same size.
  return {.material = pattern.material,
          .tint = tint,
          .repeat_per_m = pattern.repeat_per_m * draw.between(0.92F, 1.08F),
          .shift = {draw.between(0, 1), draw.between(0, 1)},
          .uneven = 0.12F};
}

Look Palette::cell(Surface atlas, Draw& draw) const {
  const Pattern& pattern = draw.of(patterns_.at(static_cast<std::size_t>(atlas)));
  const std::uint32_t cells = atlas == Surface::Picture ? kPictureCells : kCarpetCells;
  const float side = 1 / static_cast<float>(cells);
  constexpr float kMargin = 0.04F;  // of a cell, so that no filter sees its neighbour
  const glm::vec2 corner{draw.below(cells), draw.below(cells)};
  return {.material = pattern.material,
          .tint = near(glm::vec3(0.9F), 0.1F, draw),
          .repeat_per_m = side * (1 - 2 * kMargin),
          .shift = side * (corner + kMargin)};
}

glm::vec3 Palette::near(const glm::vec3& linear, float spread, Draw& draw) {
  const float bright = draw.between(1 - spread, 1 + spread);
  glm::vec3 result;
  for (int c = 0; c < 3; ++c)
    result[c] = glm::clamp(linear[c] * bright * draw.between(1 - spread, 1 + spread), 0.0F, 1.0F);
  return result;
}

}  // namespace splatbus::sim
