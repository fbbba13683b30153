#pragma once

#include <string>
#include <vector>

#include "sim/world_builder.h"
#include "sim/world_furniture.h"

namespace splatbus::sim {

enum class Side : int { Front, Right, Back, Left };

/// The frame of an outer wall: x along it and to the right as seen from outside, z outwards, origin at the middle of
/// the wall's foot and thickness.
[[nodiscard]] glm::mat4 house_from_wall(const HousePlan& house, Side side);
/// Half of its length.
[[nodiscard]] float wall_half(const HousePlan& house, Side side);
/// Windows, and the front door, in the wall's frame, from the storey's floor.
[[nodiscard]] std::vector<Opening> openings_of(const HousePlan& house, Side side, int storey);

struct Room {
  Rect rect;  ///< house x, z, between the walls
  float floor_y = 0;
  int storey = 0;
  bool front = false;
};
[[nodiscard]] std::vector<Room> rooms_of(const HousePlan& house);
/// What is kept free for walking, house x, z.
[[nodiscard]] std::vector<Rect> lanes_of(const HousePlan& house, int storey);

/// All of a house: walls, roof, rooms and what is in them.
void add_house(WorldBuilder& builder, const HousePlan& house);
// Parts of it, in its frame.
void add_roof(const Site& shell, const HousePlan& house, const Look& wall_look, Draw& draw);
void furnish(const Site& rooms, const HousePlan& house, const Room& room, RoomUse use, Draw& draw);
/// One site and one look a room, as rooms_of() has them.
void add_rooms(const std::vector<Site>& rooms, const HousePlan& house, const std::vector<Look>& room_looks, Draw& draw);
void add_stairs(const Site& site, const HousePlan& house, Draw& draw);

}  // namespace splatbus::sim
