#include <fmt/format.h>

#include <array>
#include <cmath>
#include <glm/gtc/constants.hpp>

#include "sim/patterns.h"
#include "sim/world_house.h"

namespace splatbus::sim {
namespace {

constexpr float kFoot_m = -0.8F;  // of the outer walls, under the ground

const auto& wall_tints() {
  static const std::array tints{color("#e8dcc0"), color("#d9b48a"), color("#c9876a"), color("#b9c4c9"),
                                color("#e6e2d8"), color("#c2b280"), color("#a9b79a"), color("#d7a9a0"),
                                color("#8fa3b5"), color("#efd9a7"), color("#b98f6f"), color("#cfd3bd")};
  return tints;
}
const auto& brick_tints() {
  static const std::array tints{color("#b5654f"), color("#9c5140"), color("#c58a6a"),
                                color("#8d5a4c"), color("#b98c5e"), color("#a8726a")};
  return tints;
}
const auto& paint_tints() {
  static const std::array tints{color("#f0ece0"), color("#3f6f5a"), color("#7a2f2a"), color("#2f4d77"),
                                color("#d9c9a5"), color("#4a3b32"), color("#8fa9a0")};
  return tints;
}

Look outer_look(const Site& site, Draw& draw) {
  const float kind = draw.between(0, 1);
  if (kind < 0.36F)
    return site.palette().look(Surface::Brick, Palette::near(draw.of(brick_tints()), 0.15F, draw), draw);
  const glm::vec3 tint = Palette::near(draw.of(wall_tints()), 0.12F, draw);
  return site.palette().look(kind < 0.72F ? Surface::Plaster : Surface::Siding, tint, draw);
}

/// Frame, bars and sill in an opening of an outer wall.
void add_window(const Site& wall, const Opening& o, const Look& look, Draw& draw) {
  constexpr float kFrame_m = 0.06F, kDeep_m = 0.08F;
  const float width = o.to - o.from, height = o.high - o.low, x = (o.from + o.to) / 2, y = (o.low + o.high) / 2;
  const auto bar = [&](const glm::vec3& size, const glm::vec3& at) { wall.add(box(size, 1), look, moved(at)); };
  for (const float side : {-1.0F, 1.0F}) {
    bar({kFrame_m, height, kDeep_m}, {x + side * (width - kFrame_m) / 2, y, 0});
    bar({width - 2 * kFrame_m, kFrame_m, kDeep_m}, {x, y + side * (height - kFrame_m) / 2, 0});
  }
  bar({0.045F, height - 2 * kFrame_m, 0.05F}, {x, y, 0});
  const int rows = 1 + static_cast<int>(draw.below(3));
  for (int row = 1; row < rows; ++row) {
    const float at = o.low + height * static_cast<float>(row) / static_cast<float>(rows);
    bar({(width - 2 * kFrame_m - 0.045F) / 2, 0.035F, 0.04F}, {x - width / 4 + 0.01F, at, 0});
    bar({(width - 2 * kFrame_m - 0.045F) / 2, 0.035F, 0.04F}, {x + width / 4 - 0.01F, at, 0});
  }
  bar({width + 0.16F, 0.05F, 0.14F}, {x, o.low - 0.026F, HousePlan::kWall_m / 2 + 0.07F});
}

void add_shutters(const Site& wall, const Opening& o, const Look& look) {
  const float wide = 0.42F * (o.to - o.from);
  for (const float side : {-1.0F, 1.0F}) {
    const float x = side < 0 ? o.from - wide / 2 - 0.02F : o.to + wide / 2 + 0.02F;
    const float z = HousePlan::kWall_m / 2 + 0.025F, height = o.high - o.low;
    wall.add(box({wide, height, 0.03F}, 1), look, moved({x, (o.low + o.high) / 2, z}));
    for (int slat = 0; slat < 7; ++slat) {
      const float y = o.low + height * (static_cast<float>(slat) + 0.5F) / 7;
      wall.add(box({wide - 0.08F, 0.04F, 0.02F}, 1), look, moved({x, y, z + 0.024F}));
    }
  }
}

/// Jambs, a leaf that stands open inwards, a canopy and a step.
void add_front_door(const Site& wall, const Opening& o, const Look& frame, const Look& leaf, Draw& draw) {
  constexpr float kJamb_m = 0.05F;
  const float middle = (o.from + o.to) / 2;
  for (const float side : {-1.0F, 1.0F}) {
    wall.add(box({kJamb_m, o.high, 0.34F}, 1), frame,
             moved({middle + side * (o.to - o.from - kJamb_m) / 2, o.high / 2, 0}));
  }
  wall.add(box({o.to - o.from - 2 * kJamb_m, kJamb_m, 0.34F}, 1), frame, moved({middle, o.high - kJamb_m / 2, 0}));
  const float hinge = draw.sign(), wide = o.to - o.from - 2 * kJamb_m - 0.02F;
  // The wall's inner face is at -z; at 96 degrees the leaf is out of the way.
  const Site open =
      wall.at(moved({middle + hinge * (wide / 2 + 0.02F), 0, -HousePlan::kWall_m / 2}, -hinge * glm::radians(96.0F)));
  const Site panel = open.at(moved({-hinge * wide / 2, o.high / 2 - 0.02F, 0}));
  panel.add(box({wide, o.high - kJamb_m - 0.04F, 0.045F}, 1), leaf);
  for (const float y : {-0.45F, 0.42F}) {
    for (const float z : {-1.0F, 1.0F})
      panel.add(box({wide - 0.3F, 0.62F, 0.02F}, 1), frame, moved({0, y, z * 0.026F}));
  }
  panel.add(sphere(0.035F, 10), frame, moved({-hinge * (wide / 2 - 0.08F), 0, 0.06F}));
  panel.add(sphere(0.035F, 10), frame, moved({-hinge * (wide / 2 - 0.08F), 0, -0.06F}));
  const float roof_y = o.high + 0.22F;
  wall.add(box({o.to - o.from + 0.7F, 0.08F, 0.9F}, 1), leaf, moved({middle, roof_y, HousePlan::kWall_m / 2 + 0.45F}));
  for (const float side : {-1.0F, 1.0F}) {
    wall.add(box({0.06F, 0.3F, 0.5F}, 1), frame,
             moved({middle + side * 0.75F, roof_y - 0.19F, HousePlan::kWall_m / 2 + 0.25F}));
  }
}

void add_outer_walls(const Site& shell, const std::vector<Site>& rooms, const HousePlan& house, const Look& outer,
                     const std::vector<Look>& inner, Draw& draw) {
  const Look frame = shell.palette().look(Surface::Paint, Palette::near(draw.of(paint_tints()), 0.1F, draw), draw);
  const Look leaf = shell.palette().look(Surface::Wood, Palette::near(draw.of(paint_tints()), 0.2F, draw), draw);
  const bool shutters = draw.chance(0.4F);
  for (int storey = 0; storey < house.storeys; ++storey) {
    const float base = static_cast<float>(storey) * house.storey_m();
    for (const Side side : {Side::Front, Side::Right, Side::Back, Side::Left}) {
      const std::vector<Opening> openings = openings_of(house, side, storey);
      const glm::mat4 placed = house_from_wall(house, side) * moved({0, base, 0});
      const Site outside = shell.at(placed);
      const float half = wall_half(house, side);
      // The inner face belongs to one room up to an inner wall, and to another beyond it.
      const auto first = 3 * static_cast<std::size_t>(storey);
      struct Stretch {
        float from, to;
        std::size_t room;
      };
      std::vector<Stretch> stretches{{-half, half, first}};
      if (side == Side::Back) stretches = {{-half, -house.divide_x, first + 2}, {-house.divide_x, half, first + 1}};
      if (side == Side::Right) stretches = {{-half, -house.partition_z, first}, {-house.partition_z, half, first + 2}};
      if (side == Side::Left) stretches = {{-half, house.partition_z, first + 1}, {house.partition_z, half, first}};
      for (const Stretch& stretch : stretches) {
        const Wall made =
            wall(stretch.from, stretch.to, storey == 0 ? kFoot_m : 0, house.storey_m(), HousePlan::kWall_m, openings);
        outside.add(made.front, outer);
        outside.add(made.reveals, frame);
        rooms[stretch.room].at(placed).add(made.back, inner[stretch.room]);
      }
      for (const Opening& opening : openings) {
        if (opening.low <= 0) {
          add_front_door(outside, opening, frame, leaf, draw);
        } else {
          add_window(outside, opening, frame, draw);
          if (shutters && opening.to - opening.from < 1.15F && side == Side::Front)
            add_shutters(outside, opening, leaf);
        }
      }
    }
  }
}

}  // namespace

void add_house(WorldBuilder& builder, const HousePlan& house) {
  Draw draw(builder.plan.seed + 53, house.key);
  const std::string name = fmt::format("house {}", house.key);
  const glm::mat4 world_from_house = house.world_from_house();
  const auto site = [&](const std::string& object, bool enclosed) {
    builder.frame(object, world_from_house, enclosed);
    return Site{builder, object, world_from_house};
  };
  const Site shell = site(name, false);
  std::vector<Site> rooms;
  const Look outer = outer_look(shell, draw);
  std::vector<Look> inner;
  for (std::size_t room = 0; room < rooms_of(house).size(); ++room) {
    rooms.push_back(site(fmt::format("{} room {}", name, room), true));
    const glm::vec3 tint = Palette::near(draw.of(wall_tints()), 0.15F, draw);
    inner.push_back(
        builder.palette.look(draw.chance(0.6F) ? Surface::Wallpaper : Surface::Plaster, 0.25F + 0.75F * tint, draw));
  }
  add_outer_walls(shell, rooms, house, outer, inner, draw);
  add_roof(shell, house, outer, draw);
  add_rooms(rooms, house, inner, draw);
  if (house.storeys > 1) add_stairs(site(name + " stairs", true), house, draw);
}

}  // namespace splatbus::sim
