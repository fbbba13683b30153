#include <algorithm>
#include <array>
#include <cmath>
#include <glm/gtc/constants.hpp>

#include "sim/patterns.h"
#include "sim/world_furniture.h"
#include "sim/world_house.h"

namespace splatbus::sim {
namespace {

constexpr float kThin_m = HousePlan::kPartition_m;

Rect hole_of(const HousePlan& house) {
  const float from = house.partition_z + kThin_m / 2;
  return {{std::min(house.stairs_low_x, house.stairs_high_x), from},
          {std::max(house.stairs_low_x, house.stairs_high_x), from + HousePlan::kStairs_m}};
}

/// A level rectangle without the hole, which reaches its low z.
void add_level(const Site& site, const Rect& rect, const Rect* hole, float y, bool up, const Look& look) {
  if (hole == nullptr) return site.add(level_patch(rect, y, up), look);
  for (const Rect& part : {Rect{{rect.low.x, hole->high.y}, rect.high}, Rect{rect.low, {hole->low.x, hole->high.y}},
                           Rect{{hole->high.x, rect.low.y}, {rect.high.x, hole->high.y}},
                           Rect{{hole->low.x, rect.low.y}, {hole->high.x, hole->low.y}}}) {
    if (part.size().x > 1e-3F && part.size().y > 1e-3F) site.add(level_patch(part, y, up), look);
  }
}

void add_inner_walls(const std::vector<Site>& rooms, const HousePlan& house, int storey, const std::vector<Look>& looks,
                     Draw& draw) {
  const float base = static_cast<float>(storey) * house.storey_m();
  const glm::vec2 half = house.inner_half();
  const auto first = 3 * static_cast<std::size_t>(storey);
  const Look frame = rooms.front().palette().look(Surface::Paint, Palette::near(color("#efe9da"), 0.12F, draw), draw);
  const float door = HousePlan::kInnerDoor_m / 2;
  const auto add_frame = [&](const Site& at, const Opening& o) {
    for (const float x : {o.from + 0.02F, o.to - 0.02F})
      at.add(box({0.04F, o.high, kThin_m + 0.04F}, 1), frame, moved({x, o.high / 2, 0}));
    at.add(box({o.to - o.from - 0.08F, 0.04F, kThin_m + 0.04F}, 1), frame,
           moved({(o.from + o.to) / 2, o.high - 0.02F, 0}));
  };
  const Opening through{house.inner_x - door, house.inner_x + door, -1, HousePlan::kDoorHigh_m};
  const glm::mat4 house_from_partition = moved({0, base, house.partition_z});
  const Site partition = rooms[first].at(house_from_partition);
  const struct {
    float from, to;
    std::size_t room;
  } stretches[] = {{-half.x, house.divide_x, first + 1}, {house.divide_x, half.x, first + 2}};
  for (const auto& stretch : stretches) {
    const Wall made = wall(stretch.from, stretch.to, 0, house.room_m, kThin_m, std::span(&through, 1));
    partition.add(made.front, looks[first]);
    rooms[stretch.room].at(house_from_partition).add(made.back, looks[stretch.room]);
    partition.add(made.reveals, frame);
  }
  add_frame(partition, through);
  // Its front faces +x, towards the room on the right; its own x is -z of the house.
  const float length = (half.y + house.partition_z - kThin_m / 2) / 2;
  const glm::mat4 house_from_divide =
      (moved({house.divide_x, base, (house.partition_z - kThin_m / 2 - half.y) / 2}, glm::half_pi<float>()));
  const Site divide = rooms[first + 2].at(house_from_divide);
  const float middle = -(house.back_z() - (house.partition_z - kThin_m / 2 - half.y) / 2);
  const Opening between{middle - door, middle + door, -1, HousePlan::kDoorHigh_m};
  const Wall made = wall(-length, length, 0, house.room_m, kThin_m, std::span(&between, 1));
  divide.add(made.front, looks[first + 2]);
  rooms[first + 1].at(house_from_divide).add(made.back, looks[first + 1]);
  divide.add(made.reveals, frame);
  add_frame(divide, between);
}

}  // namespace

void add_stairs(const Site& site, const HousePlan& house, Draw& draw) {
  const Look step_look = site.palette().look(Surface::Wood, Palette::near(color("#b98a56"), 0.25F, draw), draw);
  const Look rail = site.palette().look(Surface::Wood, Palette::near(color("#6b4a30"), 0.3F, draw), draw);
  const Look edge = site.palette().look(Surface::Paint, color("#e8e2d6"), draw);
  constexpr int kSteps = 17;
  const float rise = house.storey_m() / kSteps, run = (house.stairs_high_x - house.stairs_low_x) / kSteps;
  for (int i = 0; i < kSteps; ++i) {
    const float height = rise * static_cast<float>(i + 1),
                x = house.stairs_low_x + run * (static_cast<float>(i) + 0.5F);
    site.add(box({std::abs(run), height - 0.002F, HousePlan::kStairs_m - 0.02F}, 1), step_look,
             moved({x, height / 2, house.stairs_z}));
    if (i % 2 == 0) {  // banisters
      site.add(cylinder(0.014F, 0.85F, 6), rail, moved({x, height, house.stairs_z + HousePlan::kStairs_m / 2 - 0.04F}));
    }
  }
  const float lean = std::atan2(house.storey_m(), house.stairs_high_x - house.stairs_low_x);
  const float length = std::hypot(house.storey_m(), house.stairs_high_x - house.stairs_low_x);
  const Site hand = site.at(moved({(house.stairs_low_x + house.stairs_high_x) / 2, house.storey_m() / 2 + 0.95F,
                                   house.stairs_z + HousePlan::kStairs_m / 2 - 0.04F}));
  hand.add(box({length, 0.05F, 0.05F}, 1), rail, glm::mat4_cast(glm::angleAxis(lean, glm::vec3(0, 0, 1))));
  // The hole's edges, and a railing at the two that one could fall over.
  const Rect hole = hole_of(house);
  const float low = house.room_m, high = house.storey_m();
  const auto upright = [&](const glm::vec2& a, const glm::vec2& b) {
    site.add(patch({a.x, low, a.y}, {b.x, low, b.y}, {b.x, high, b.y}, {a.x, high, a.y}), edge);
  };
  upright({hole.low.x, hole.low.y}, {hole.high.x, hole.low.y});
  upright({hole.high.x, hole.low.y}, {hole.high.x, hole.high.y});
  upright({hole.high.x, hole.high.y}, {hole.low.x, hole.high.y});
  upright({hole.low.x, hole.high.y}, {hole.low.x, hole.low.y});
  const auto railing = [&](const glm::vec2& a, const glm::vec2& b) {
    const glm::vec2 middle = (a + b) / 2.0F, size = glm::abs(b - a);
    for (const float y : {0.12F, 0.95F})
      site.add(box({size.x + 0.05F, 0.05F, size.y + 0.05F}, 1), rail, moved({middle.x, high + y, middle.y}));
    const int posts = static_cast<int>((size.x + size.y) / 0.13F);
    for (int i = 0; i <= posts; ++i) {
      const glm::vec2 at = glm::mix(a, b, static_cast<float>(i) / static_cast<float>(posts));
      site.add(box({0.025F, 0.95F, 0.025F}, 1), rail, moved({at.x, high + 0.475F, at.y}));
    }
  };
  const float beside = hole.high.y + 0.04F,
              end = house.stairs_low_x < house.stairs_high_x ? hole.low.x - 0.04F : hole.high.x + 0.04F;
  railing({hole.low.x, beside}, {hole.high.x, beside});
  railing({end, hole.low.y + 0.03F}, {end, beside});
}

void add_rooms(const std::vector<Site>& rooms, const HousePlan& house, const std::vector<Look>& room_looks,
               Draw& draw) {
  const std::vector<Room> list = rooms_of(house);
  const Rect hole = hole_of(house);
  const Look ceiling = rooms.front().palette().look(Surface::Paint, Palette::near(color("#f4f1ea"), 0.06F, draw), draw);
  for (std::size_t i = 0; i < list.size(); ++i) {
    const Room& room = list[i];
    // Floors meet in the middle of inner walls, which is where their doors are.
    Rect rect = room.rect;
    if (room.front) {
      rect.low.y -= kThin_m / 2;
    } else {
      rect.high.y += kThin_m / 2;
      (room.rect.low.x > house.divide_x ? rect.low.x : rect.high.x) = house.divide_x;
    }
    const bool kitchen = i % 3 == 1 && room.storey == 0;
    const bool tiles = kitchen || draw.chance(0.15F);
    static const std::array kFloors{color("#c99a66"), color("#9a6b42"), color("#b9a078"), color("#7c5a3e"),
                                    color("#d9b98a")};
    const Look floor = rooms.front().palette().look(
        tiles ? Surface::Tiles : Surface::Boards,
        Palette::near(tiles ? glm::vec3(0.6F, 0.55F, 0.5F) : draw.of(kFloors), 0.2F, draw), draw);
    const bool open_below = room.front && room.storey > 0, open_above = room.front && room.storey + 1 < house.storeys;
    add_level(rooms[i], rect, open_below ? &hole : nullptr, room.floor_y, true, floor);
    add_level(rooms[i], rect, open_above ? &hole : nullptr, room.floor_y + house.room_m, false, ceiling);
    const RoomUse use = room.storey > 0     ? RoomUse::Bedroom
                        : room.front        ? RoomUse::Living
                        : kitchen           ? RoomUse::Kitchen
                        : draw.chance(0.6F) ? RoomUse::Bedroom
                                            : RoomUse::Living;
    furnish(rooms[i], house, room, use, draw);
  }
  for (int storey = 0; storey < house.storeys; ++storey) add_inner_walls(rooms, house, storey, room_looks, draw);
}

}  // namespace splatbus::sim
