#include <algorithm>
#include <cmath>
#include <glm/gtc/constants.hpp>

#include "sim/world_house.h"

namespace splatbus::sim {

glm::mat4 house_from_wall(const HousePlan& house, Side side) {
  const float out_x = (house.width_m - HousePlan::kWall_m) / 2, out_z = (house.depth_m - HousePlan::kWall_m) / 2;
  const auto turn = glm::half_pi<float>();
  switch (side) {
    case Side::Front:
      return moved({0, 0, out_z});
    case Side::Right:
      return moved({out_x, 0, 0}, turn);
    case Side::Back:
      return moved({0, 0, -out_z}, 2 * turn);
    default:
      return moved({-out_x, 0, 0}, -turn);
  }
}

float wall_half(const HousePlan& house, Side side) {
  return side == Side::Front || side == Side::Back ? house.width_m / 2 : house.inner_half().y;
}

std::vector<Opening> openings_of(const HousePlan& house, Side side, int storey) {
  Draw draw(house.key * 7 + 5, static_cast<std::uint32_t>(side) + 10 * static_cast<std::uint32_t>(storey));
  std::vector<Opening> openings;
  // Where a window cannot be: doors and inner walls, in the wall's frame.
  std::vector<float> taken;
  if (side == Side::Front && storey == 0) {
    const float half = HousePlan::kDoor_m / 2;
    openings.push_back({house.door_x - half, house.door_x + half, 0, HousePlan::kDoorHigh_m});
    taken.push_back(house.door_x);
  }
  if (side == Side::Right) taken.push_back(-house.partition_z);
  if (side == Side::Left) taken.push_back(house.partition_z);
  if (side == Side::Back) taken.push_back(-house.divide_x);
  const float half = wall_half(house, side) - 0.75F;
  const int count = std::max(1, static_cast<int>(2 * half / draw.between(2.4F, 3.1F)));
  const float step = 2 * half / static_cast<float>(count);
  const float width = std::min(draw.between(0.85F, 1.35F), step - 0.5F), low = draw.between(0.8F, 1.0F);
  const float high = std::min(low + draw.between(1.0F, 1.3F), house.room_m - 0.25F);
  for (int i = 0; i < count; ++i) {
    const float middle = -half + (static_cast<float>(i) + 0.5F) * step;
    const auto hinders = [&](float at) {
      return std::abs(at - middle) < width / 2 + (side == Side::Front ? 0.85F : 0.3F);
    };
    if (std::ranges::any_of(taken, hinders) || draw.chance(0.12F)) continue;
    openings.push_back({middle - width / 2, middle + width / 2, low, high});
  }
  return openings;
}

std::vector<Room> rooms_of(const HousePlan& house) {
  const glm::vec2 half = house.inner_half();
  constexpr float kThin = HousePlan::kPartition_m / 2;
  std::vector<Room> rooms;
  for (int storey = 0; storey < house.storeys; ++storey) {
    const float floor_y = static_cast<float>(storey) * house.storey_m();
    rooms.push_back({{{-half.x, house.partition_z + kThin}, half}, floor_y, storey, true});
    rooms.push_back({{-half, {house.divide_x - kThin, house.partition_z - kThin}}, floor_y, storey, false});
    rooms.push_back({{{house.divide_x + kThin, -half.y}, {half.x, house.partition_z - kThin}}, floor_y, storey, false});
  }
  return rooms;
}

std::vector<Rect> lanes_of(const HousePlan& house, int storey) {
  constexpr float kHalf_m = 0.62F;
  std::vector<Rect> lanes;
  const auto lane = [&](const glm::vec2& a, const glm::vec2& b) {
    lanes.push_back(Rect{glm::min(a, b), glm::max(a, b)}.grown(kHalf_m));
  };
  const float divide_side = house.inner_x > house.divide_x ? -1.0F : 1.0F;
  lane({house.inner_x, house.aisle_z()}, {house.inner_x, house.back_z()});
  lane({house.inner_x, house.back_z()}, {house.divide_x + divide_side, house.back_z()});
  if (storey == 0) {
    lane({house.door_x, house.inner_half().y}, {house.door_x, house.aisle_z()});
    lane({house.door_x, house.aisle_z()}, {house.inner_x, house.aisle_z()});
  }
  if (house.storeys > 1) {
    // Stairs, and what is before and behind them.
    const float out = house.stairs_high_x > house.stairs_low_x ? 0.7F : -0.7F;
    lane({house.stairs_low_x - out, house.stairs_z}, {house.stairs_high_x + out, house.stairs_z});
    lane({house.stairs_high_x + out, house.stairs_z}, {house.inner_x, house.stairs_z});
    lane({house.stairs_low_x - out, house.stairs_z}, {house.stairs_low_x - out, house.aisle_z()});
    if (storey == 0) lane({house.stairs_low_x - out, house.aisle_z()}, {house.door_x, house.aisle_z()});
  }
  return lanes;
}

}  // namespace splatbus::sim
