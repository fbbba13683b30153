#include <algorithm>
#include <cmath>
#include <glm/gtc/constants.hpp>

#include "sim/world_furniture.h"
#include "sim/world_house.h"

namespace splatbus::sim {
namespace {

/// A wall as a room sees it: its frame has x along it, z into the room and y from the floor.
struct Face {
  glm::mat4 house_from_face;
  float half_m;
  std::vector<Opening> openings;  ///< in the face's frame
};

std::vector<Opening> mirrored(const std::vector<Opening>& openings, float by) {
  // The outer wall's x runs the other way.
  std::vector<Opening> result;
  result.reserve(openings.size());
  for (const Opening& o : openings) result.push_back({by - o.to, by - o.from, o.low, o.high});
  return result;
}

/// The walls of a room; outer ones have windows, and inner ones doors.
std::vector<Face> faces_of(const HousePlan& house, const Room& room) {
  const glm::vec2 half = house.inner_half(), middle = room.rect.middle(), size = room.rect.size() / 2.0F;
  constexpr auto kQuarter = glm::half_pi<float>();
  const float inner = HousePlan::kInnerDoor_m / 2;
  const auto near = [](float a, float b) { return std::abs(a - b) < 0.01F; };
  std::vector<Face> faces;
  // Seen from inside, at the back (-z), front, left and right of the room.
  Face back{moved({middle.x, room.floor_y, room.rect.low.y}), size.x, {}};
  back.openings =
      near(room.rect.low.y, -half.y)
          ? mirrored(openings_of(house, Side::Back, room.storey), -middle.x)
          : std::vector<Opening>{{house.inner_x - inner - middle.x, house.inner_x + inner - middle.x, 0, 3}};
  Face front{moved({middle.x, room.floor_y, room.rect.high.y}, 2 * kQuarter), size.x, {}};
  front.openings =
      near(room.rect.high.y, half.y)
          ? mirrored(openings_of(house, Side::Front, room.storey), middle.x)
          : std::vector<Opening>{{middle.x - house.inner_x - inner, middle.x - house.inner_x + inner, 0, 3}};
  const float door = house.back_z() - middle.y;
  Face left{moved({room.rect.low.x, room.floor_y, middle.y}, kQuarter), size.y, {}};
  left.openings = near(room.rect.low.x, -half.x) ? mirrored(openings_of(house, Side::Left, room.storey), middle.y)
                                                 : std::vector<Opening>{{-door - inner, -door + inner, 0, 3}};
  Face right{moved({room.rect.high.x, room.floor_y, middle.y}, -kQuarter), size.y, {}};
  right.openings = near(room.rect.high.x, half.x) ? mirrored(openings_of(house, Side::Right, room.storey), -middle.y)
                                                  : std::vector<Opening>{{door - inner, door + inner, 0, 3}};
  return {back, front, left, right};
}

bool is_free(const Opening& space, const std::vector<Opening>& taken) {
  return std::ranges::none_of(taken, [&](const Opening& o) {
    return space.from < o.to && o.from < space.to && space.low < o.high && o.low < space.high;
  });
}

}  // namespace

void furnish(const Site& rooms, const HousePlan& house, const Room& room, RoomUse use, Draw& draw) {
  std::vector<Rect> taken = lanes_of(house, room.storey);
  std::vector<Face> faces = faces_of(house, room);
  for (const Furniture& item : furniture_of(use, draw)) {
    for (int attempt = 0; attempt < 40; ++attempt) {
      Face& face = faces[draw.below(faces.size())];
      constexpr float kGap_m = 0.04F;
      const float slack = face.half_m - item.footprint.x / 2 - 0.1F, deep = item.footprint.y / 2 + kGap_m;
      const float along = draw.between(-1, 1) * std::max(slack, 0.0F);
      if (slack < 0) continue;
      const glm::mat4 placed = face.house_from_face * moved({along, 0, deep});
      Bounds bounds;
      bounds.add(placed * glm::vec4(-item.footprint.x / 2, 0, -item.footprint.y / 2, 1));
      bounds.add(placed * glm::vec4(item.footprint.x / 2, 0, item.footprint.y / 2, 1));
      const Rect rect{{bounds.low.x, bounds.low.z}, {bounds.high.x, bounds.high.z}};
      const Rect inside{room.rect.low - 1e-3F, room.rect.high + 1e-3F};
      if (!inside.holds(rect.low) || !inside.holds(rect.high)) continue;
      if (std::ranges::any_of(taken, [&](const Rect& other) { return other.overlaps(rect); })) continue;
      taken.push_back(rect.grown(0.05F));
      const Opening behind{along - item.footprint.x / 2, along + item.footprint.x / 2, 0, 2.2F};
      face.openings.push_back(behind);
      item.add(rooms.at(placed), item.footprint, draw);
      break;
    }
  }
  // Carpets lie in the middle, a little above the floor.
  const glm::vec2 middle = room.rect.middle(),
                  size =
                      glm::min(room.rect.size() * 0.5F, glm::vec2(draw.between(1.5F, 2.4F), draw.between(1.1F, 1.8F)));
  if (draw.chance(0.7F) && !(house.storeys > 1 && room.front)) {
    Mesh carpet = box({size.x, 0.012F, size.y});
    rooms.add(carpet, rooms.palette().cell(Surface::Carpet, draw), moved({middle.x, room.floor_y + 0.006F, middle.y}));
  }
  for (Face& face : faces) {
    const int pictures = static_cast<int>(draw.below(3)) + (face.half_m > 2 ? 1 : 0);
    for (int i = 0; i < pictures; ++i) {
      const glm::vec2 picture{draw.between(0.35F, 0.9F), draw.between(0.35F, 0.75F)};
      const float slack = face.half_m - picture.x / 2 - 0.15F, y = draw.between(1.5F, 1.7F);
      if (slack < 0) continue;
      const float x = draw.between(-slack, slack);
      const Opening space{x - picture.x / 2 - 0.06F, x + picture.x / 2 + 0.06F, y - picture.y / 2, y + picture.y / 2};
      if (!is_free(space, face.openings)) continue;
      face.openings.push_back(space);
      add_picture(rooms.at(face.house_from_face * moved({x, y, 0})), picture, draw);
    }
  }
}

}  // namespace splatbus::sim
