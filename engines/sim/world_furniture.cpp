#include "sim/world_furniture.h"

#include <algorithm>
#include <array>
#include <glm/gtc/matrix_transform.hpp>

#include "sim/patterns.h"

namespace splatbus::sim {
namespace {

Look wood(const Site& site, Draw& draw) {
  static const std::array tints{color("#c99a5b"), color("#8a5a34"), color("#b4764a"),
                                color("#e3c796"), color("#5e3a26"), color("#efe8da")};
  return site.palette().look(Surface::Wood, Palette::near(draw.of(tints), 0.15F, draw), draw);
}

Look knob_look(const Site& site, Draw& draw) {
  return site.palette().look(Surface::Paint, Palette::near(color("#5a564e"), 0.4F, draw), draw);
}

Look cloth(const Site& site, Draw& draw) {
  return site.palette().look(Surface::Fabric, any_tint(draw), draw);
}

void put(const Site& site, const Look& look, const glm::vec3& size, const glm::vec3& middle) {
  site.add(box(size, 1), look, moved(middle));
}

void add_sofa(const Site& site, const glm::vec2& f, Draw& draw) {
  const Look look = cloth(site, draw), cushions = cloth(site, draw);
  put(site, look, {f.x, 0.3F, f.y}, {0, 0.22F, 0});
  put(site, look, {f.x, 0.5F, 0.2F}, {0, 0.6F, -f.y / 2 + 0.1F});
  for (const float side : {-1.0F, 1.0F}) {
    put(site, look, {0.18F, 0.3F, f.y - 0.2F}, {side * (f.x / 2 - 0.09F), 0.5F, 0.1F});
    for (const float z : {-1.0F, 1.0F})
      put(site, look, {0.06F, 0.07F, 0.06F}, {side * (f.x / 2 - 0.1F), 0.035F, z * (f.y / 2 - 0.1F)});
  }
  const int seats = f.x > 1.5F ? 3 : 2;
  for (int i = 0; i < seats; ++i) {
    const float wide = (f.x - 0.4F) / static_cast<float>(seats);
    const float x = -f.x / 2 + 0.2F + wide * (static_cast<float>(i) + 0.5F);
    site.add(capsule(0.08F, wide - 0.2F, 12, 1), cushions,
             glm::rotate(moved({x, 0.42F, 0.1F}), glm::radians(90.0F), {0, 0, 1}));
    put(site, cushions, {wide - 0.03F, 0.1F, f.y - 0.3F}, {x, 0.41F, 0.1F});
    site.add(sphere(0.16F, 14), cushions,
             glm::scale(glm::rotate(moved({x, 0.6F, -f.y / 2 + 0.27F}), 0.3F * draw.between(-1, 1), {0, 0, 1}),
                        {1.1F, 1, 0.45F}));
  }
}

void add_shelf(const Site& site, const glm::vec2& f, Draw& draw) {
  const Look look = wood(site, draw);
  const float height = draw.between(1.5F, 2.05F), thick = 0.03F;
  for (const float side : {-1.0F, 1.0F})
    put(site, look, {thick, height, f.y}, {side * (f.x - thick) / 2, height / 2, 0});
  put(site, look, {f.x - 2 * thick, height, 0.015F}, {0, height / 2, -f.y / 2 + 0.008F});
  const int shelves = 4 + static_cast<int>(draw.below(2));
  for (int i = 0; i <= shelves; ++i) {
    const float y = 0.06F + (height - 0.08F) * static_cast<float>(i) / static_cast<float>(shelves);
    put(site, look, {f.x - 2 * thick, 0.025F, f.y - 0.03F}, {0, y, 0.01F});
    if (i == shelves) break;
    const Site level = site.at(moved({0, y + 0.0125F, 0.02F}));
    const float room = (height - 0.08F) / static_cast<float>(shelves) - 0.05F;
    if (draw.chance(0.25F)) {
      add_things(level, {f.x - 0.2F, f.y - 0.12F}, 3, draw);
      continue;
    }
    for (float x = -f.x / 2 + 0.05F; x < f.x / 2 - 0.08F;) {
      const float wide = draw.between(0.018F, 0.055F), tall = std::min(room, draw.between(0.16F, 0.29F));
      if (draw.chance(0.93F)) {
        const Look book =
            site.palette().look(draw.chance(0.5F) ? Surface::Paint : Surface::Fabric, any_tint(draw), draw);
        put(level, book, {wide, tall, draw.between(0.14F, 0.2F)}, {x + wide / 2, tall / 2, 0});
      }
      x += wide + 0.003F;
    }
  }
}

void add_cupboard(const Site& site, const glm::vec2& f, Draw& draw) {
  const Look look = wood(site, draw), knob = site.palette().look(Surface::Paint, color("#3a3a3c"), draw);
  const float height = draw.between(1.75F, 2.1F);
  put(site, look, {f.x, height - 0.08F, f.y}, {0, 0.08F + (height - 0.08F) / 2, 0});
  put(site, look, {f.x - 0.08F, 0.08F, f.y - 0.06F}, {0, 0.04F, 0});
  const Look door = wood(site, draw);
  const int doors = f.x > 1.2F ? 3 : 2;
  for (int i = 0; i < doors; ++i) {
    const float wide = f.x / static_cast<float>(doors), x = -f.x / 2 + wide * (static_cast<float>(i) + 0.5F);
    put(site, door, {wide - 0.03F, height - 0.16F, 0.02F}, {x, height / 2 + 0.03F, f.y / 2 + 0.01F});
    site.add(sphere(0.018F, 8), knob, moved({x + wide * 0.36F, height * 0.48F, f.y / 2 + 0.035F}));
  }
}

void add_counter(const Site& site, const glm::vec2& f, Draw& draw) {
  const Look look = wood(site, draw), top = site.palette().look(Surface::Tiles, any_tint(draw), draw);
  const Look steel = site.palette().look(Surface::Paint, color("#9aa0a4"), draw);
  put(site, look, {f.x, 0.86F, f.y - 0.04F}, {0, 0.43F, -0.02F});
  put(site, top, {f.x, 0.04F, f.y}, {0, 0.88F, 0});
  const int fronts = std::max(2, static_cast<int>(f.x / 0.55F));
  for (int i = 0; i < fronts; ++i) {
    const float wide = f.x / static_cast<float>(fronts), x = -f.x / 2 + wide * (static_cast<float>(i) + 0.5F);
    put(site, look, {wide - 0.02F, 0.6F, 0.02F}, {x, 0.36F, f.y / 2 - 0.03F});
    put(site, look, {wide - 0.02F, 0.14F, 0.02F}, {x, 0.76F, f.y / 2 - 0.03F});
    put(site, steel, {0.14F, 0.015F, 0.03F}, {x, 0.77F, f.y / 2 - 0.01F});
  }
  put(site, steel, {0.5F, 0.012F, 0.4F}, {-f.x / 4, 0.906F, 0});
  for (const float x : {-0.12F, 0.12F}) {
    for (const float z : {-0.09F, 0.09F})
      site.add(cylinder(0.07F, 0.012F, 14), knob_look(site, draw), moved({x - f.x / 4, 0.912F, z}));
  }
  add_things(site.at(moved({f.x / 4, 0.9F, 0})), {f.x * 0.4F, f.y - 0.2F}, 5, draw);
  // Wall cupboards.
  put(site, look, {f.x, 0.62F, 0.32F}, {0, 1.72F, -f.y / 2 + 0.16F});
  for (int i = 0; i < fronts; ++i) {
    const float wide = f.x / static_cast<float>(fronts), x = -f.x / 2 + wide * (static_cast<float>(i) + 0.5F);
    put(site, look, {wide - 0.02F, 0.58F, 0.02F}, {x, 1.72F, -f.y / 2 + 0.33F});
  }
}

void add_bed(const Site& site, const glm::vec2& f, Draw& draw) {
  const Look frame = wood(site, draw), cover = cloth(site, draw),
             pillow = site.palette().look(Surface::Fabric, color("#ece7da"), draw);
  put(site, frame, {f.x, 0.26F, f.y}, {0, 0.2F, 0});
  put(site, frame, {f.x, draw.between(0.8F, 1.15F), 0.06F}, {0, 0.5F, -f.y / 2 + 0.03F});
  put(site, pillow, {f.x - 0.08F, 0.2F, f.y - 0.12F}, {0, 0.42F, 0.02F});
  put(site, cover, {f.x - 0.02F, 0.16F, f.y * 0.66F}, {0, 0.46F, f.y * 0.16F});
  const int pillows = f.x > 1.3F ? 2 : 1;
  for (int i = 0; i < pillows; ++i) {
    const float x = pillows == 1 ? 0 : (static_cast<float>(i) - 0.5F) * f.x * 0.46F;
    site.add(sphere(0.3F, 16, 1), pillow, glm::scale(moved({x, 0.57F, -f.y / 2 + 0.36F}), {1, 0.27F, 0.62F}));
  }
}

void add_desk(const Site& site, const glm::vec2& f, Draw& draw) {
  add_table(site, f, draw);
  const Look dark = site.palette().look(Surface::Paint, color("#26282b"), draw),
             screen = site.palette().cell(Surface::Picture, draw);
  put(site, dark, {0.56F, 0.36F, 0.03F}, {0, 1.02F, -0.14F});
  site.add(patch({-0.26F, 0.86F, -0.12F}, {0.26F, 0.86F, -0.12F}, {0.26F, 1.18F, -0.12F}, {-0.26F, 1.18F, -0.12F}, 9),
           Look{.material = screen.material,
                .tint = screen.tint,
                .repeat_per_m = screen.repeat_per_m / 0.52F,
                .shift = screen.shift});
  put(site, dark, {0.06F, 0.12F, 0.04F}, {0, 0.8F, -0.14F});
  put(site, dark, {0.4F, 0.02F, 0.14F}, {0, 0.765F, 0.1F});
}

void add_chest(const Site& site, const glm::vec2& f, Draw& draw) {
  const Look look = wood(site, draw), front = wood(site, draw), knob = knob_look(site, draw);
  const float height = draw.between(0.6F, 0.95F);
  put(site, look, {f.x, height, f.y}, {0, height / 2, 0});
  const int drawers = 3;
  for (int i = 0; i < drawers; ++i) {
    const float high = (height - 0.06F) / drawers, y = 0.04F + high * (static_cast<float>(i) + 0.5F);
    put(site, front, {f.x - 0.06F, high - 0.03F, 0.02F}, {0, y, f.y / 2 + 0.01F});
    for (const float side : {-1.0F, 1.0F})
      site.add(sphere(0.02F, 8), knob, moved({side * f.x * 0.25F, y, f.y / 2 + 0.035F}));
  }
  add_things(site.at(moved({0, height, 0})), f - 0.15F, 4, draw);
}

void add_boxes(const Site& site, const glm::vec2& f, Draw& draw) {
  float y = 0;
  for (int i = 0; i < 3; ++i) {
    const float shrink = 1 - 0.18F * static_cast<float>(i), height = draw.between(0.25F, 0.45F);
    const Look look = site.palette().look(draw.chance(0.5F) ? Surface::Wood : Surface::Paint, any_tint(draw), draw);
    site.add(box({shrink * f.x * 0.9F, height, shrink * f.y * 0.9F}, 1), look,
             moved({0, y + height / 2, 0}, draw.between(-0.09F, 0.09F)));
    y += height;
  }
}

void add_lamp(const Site& site, const glm::vec2& /*f*/, Draw& draw) {
  const Look metal = site.palette().look(Surface::Paint, color("#55504a"), draw), shade = cloth(site, draw);
  const float height = draw.between(1.25F, 1.6F);
  site.add(cylinder(0.15F, 0.03F, 18), metal);
  site.add(cylinder(0.016F, height, 8), metal);
  site.add(lathe(std::array<glm::vec2, 5>{{{0.05F, 0}, {0.21F, 0}, {0.14F, 0.3F}, {0.04F, 0.3F}, {0.05F, 0}}}, 20, 2),
           shade, moved({0, height - 0.06F, 0}));
}

}  // namespace

glm::vec3 any_tint(Draw& draw) {
  const glm::vec3 hue(draw.between(0.08F, 0.9F), draw.between(0.08F, 0.85F), draw.between(0.08F, 0.85F));
  return glm::mix(glm::vec3((hue.x + hue.y + hue.z) / 3), hue, draw.between(0.35F, 0.95F));
}

void add_things(const Site& top, const glm::vec2& area, int count, Draw& draw) {
  for (int i = 0; i < count; ++i) {
    const float cell = area.x / static_cast<float>(count);
    const glm::vec3 at{-area.x / 2 + cell * (static_cast<float>(i) + 0.5F), 0, area.y * draw.between(-0.3F, 0.3F)};
    const float widest = std::min(cell, area.y) * 0.45F, radius = std::min(draw.between(0.03F, 0.08F), widest);
    const Look look = top.palette().look(draw.chance(0.5F) ? Surface::Paint : Surface::Fabric, any_tint(draw), draw);
    const float kind = draw.between(0, 1);
    if (kind < 0.35F) {
      const float height = draw.between(0.05F, 0.2F);
      top.add(box({1.5F * radius, height, 1.3F * radius}, 1), look,
              moved(at + glm::vec3(0, height / 2, 0), draw.between(-0.4F, 0.4F)));
    } else if (kind < 0.6F) {
      top.add(cylinder(radius * 0.7F, draw.between(0.07F, 0.13F), 14), look, moved(at));
    } else if (kind < 0.85F) {
      const float high = draw.between(0.15F, 0.24F), r = radius;
      top.add(lathe(std::array<glm::vec2, 6>{{{0, 0},
                                              {0.6F * r, 0},
                                              {r, 0.35F * high},
                                              {0.45F * r, 0.75F * high},
                                              {0.6F * r, high},
                                              {0, 0.9F * high}}},
                    18, 2),
              look, moved(at));
    } else {
      top.add(sphere(radius, 14), look, moved(at + glm::vec3(0, radius, 0)));
    }
  }
}

void add_table(const Site& site, const glm::vec2& f, Draw& draw) {
  const Look look = wood(site, draw);
  const float height = draw.between(0.7F, 0.76F), leg = draw.between(0.04F, 0.08F);
  put(site, look, {f.x, 0.035F, f.y}, {0, height - 0.018F, 0});
  put(site, look, {f.x - 0.14F, 0.08F, f.y - 0.14F}, {0, height - 0.075F, 0});
  for (const float x : {-1.0F, 1.0F}) {
    for (const float z : {-1.0F, 1.0F})
      put(site, look, {leg, height - 0.036F, leg}, {x * (f.x / 2 - leg), (height - 0.036F) / 2, z * (f.y / 2 - leg)});
  }
  add_things(site.at(moved({0, height, 0.12F})), f - 0.25F, 3, draw);
}

void add_chair(const Site& site, const glm::vec2& f, Draw& draw) {
  const Look look = wood(site, draw), seat = cloth(site, draw);
  constexpr float kLeg_m = 0.035F;
  const float back = draw.between(0.8F, 1.0F);
  put(site, seat, {f.x, 0.05F, f.y}, {0, 0.45F, 0});
  for (const float x : {-1.0F, 1.0F}) {
    put(site, look, {kLeg_m, 0.425F, kLeg_m}, {x * (f.x - kLeg_m) / 2, 0.212F, (f.y - kLeg_m) / 2});
    put(site, look, {kLeg_m, back, kLeg_m}, {x * (f.x - kLeg_m) / 2, back / 2, -(f.y - kLeg_m) / 2 - 0.03F});
  }
  const int bars = 2 + static_cast<int>(draw.below(3));
  for (int i = 0; i < bars; ++i) {
    const float y = 0.58F + (back - 0.64F) * static_cast<float>(i) / static_cast<float>(std::max(1, bars - 1));
    put(site, look, {f.x - 2 * kLeg_m, 0.05F, 0.02F}, {0, y, -(f.y - kLeg_m) / 2 - 0.03F});
  }
}

void add_plant(const Site& site, const glm::vec2& f, Draw& draw) {
  const Look pot = site.palette().look(Surface::Plaster, any_tint(draw), draw);
  const Look leaf = site.palette().look(Surface::Leaves, Palette::near(color("#4d8a3a"), 0.3F, draw), draw);
  const float r = 0.4F * std::min(f.x, f.y), high = draw.between(0.25F, 0.4F);
  site.add(
      lathe(std::array<glm::vec2, 5>{{{0, 0}, {0.65F * r, 0}, {r, high}, {0.85F * r, high}, {0, high - 0.05F}}}, 18, 2),
      pot);
  const int leaves = 9 + static_cast<int>(draw.below(8));
  for (int i = 0; i < leaves; ++i) {
    const glm::mat4 turn = moved({0, high - 0.03F, 0}, draw.between(0, 6.28F));
    const glm::mat4 lean = glm::rotate(turn, draw.between(0.1F, 0.75F), {0, 0, 1});
    const float length = draw.between(0.25F, 0.55F);
    site.add(sphere(0.5F, 8, 1), leaf, glm::scale(glm::translate(lean, {0, length / 2, 0}), {0.16F, length, 0.03F}));
  }
}

void add_picture(const Site& site, const glm::vec2& size, Draw& draw) {
  const Look frame = wood(site, draw);
  Look canvas = site.palette().cell(Surface::Picture, draw);
  constexpr float kFrame_m = 0.04F, kDeep_m = 0.035F;
  for (const float side : {-1.0F, 1.0F}) {
    site.add(box({size.x, kFrame_m, kDeep_m}, 1), frame, moved({0, side * (size.y - kFrame_m) / 2, kDeep_m / 2}));
    site.add(box({kFrame_m, size.y - 2 * kFrame_m, kDeep_m}, 1), frame,
             moved({side * (size.x - kFrame_m) / 2, 0, kDeep_m / 2}));
  }
  const glm::vec2 half = size / 2.0F - kFrame_m;
  Mesh face =
      patch({-half.x, -half.y, 0.02F}, {half.x, -half.y, 0.02F}, {half.x, half.y, 0.02F}, {-half.x, half.y, 0.02F}, 9);
  for (Vertex& vertex : face.vertices) vertex.uv /= 2.0F * half;  // the whole cell, whatever the shape
  site.add(face, canvas);
}

std::vector<Furniture> furniture_of(RoomUse use, Draw& draw) {
  const auto size = [&](float x0, float x1, float z0, float z1) {
    return glm::vec2(draw.between(x0, x1), draw.between(z0, z1));
  };
  std::vector<Furniture> list;
  if (use == RoomUse::Living) {
    list = {{size(1.3F, 2.1F, 0.8F, 0.95F), add_sofa},
            {size(0.8F, 1.4F, 0.26F, 0.34F), add_shelf},
            {size(0.8F, 1.2F, 0.4F, 0.5F), add_chest},
            {size(1.0F, 1.5F, 0.7F, 0.9F), add_table},
            {{0.45F, 0.45F}, add_chair},
            {{0.46F, 0.46F}, add_lamp},
            {size(0.4F, 0.6F, 0.4F, 0.6F), add_plant},
            {size(0.7F, 1.1F, 0.26F, 0.32F), add_shelf}};
  } else if (use == RoomUse::Kitchen) {
    list = {{size(1.5F, 2.2F, 0.58F, 0.65F), add_counter},
            {size(0.9F, 1.2F, 0.6F, 0.8F), add_table},
            {size(0.7F, 1.0F, 0.5F, 0.6F), add_cupboard},
            {{0.44F, 0.44F}, add_chair},
            {{0.42F, 0.42F}, add_chair},
            {size(0.4F, 0.6F, 0.4F, 0.6F), add_boxes},
            {size(0.4F, 0.5F, 0.4F, 0.5F), add_plant}};
  } else {
    list = {{size(0.95F, 1.7F, 1.95F, 2.1F), add_bed},
            {size(0.9F, 1.6F, 0.55F, 0.6F), add_cupboard},
            {size(0.9F, 1.3F, 0.55F, 0.65F), add_desk},
            {{0.42F, 0.42F}, add_chair},
            {size(0.6F, 0.9F, 0.4F, 0.48F), add_chest},
            {size(0.4F, 0.6F, 0.4F, 0.6F), add_boxes},
            {{0.46F, 0.46F}, add_lamp},
            {size(0.6F, 0.9F, 0.26F, 0.3F), add_shelf}};
  }
  return list;
}

}  // namespace splatbus::sim
