#include "sim/world_plan.h"

#include <algorithm>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <glm/gtc/matrix_transform.hpp>

#include "sim/paint.h"

namespace splatbus::sim {
namespace {

constexpr float kFlight_m = 4.2F;  // of stairs, in plan
constexpr float kLevelCrossing_m = 7;

glm::vec2 turned(const glm::vec2& p, float yaw) {
  // As glm::rotate about y does with (x, z).
  return {std::cos(yaw) * p.x + std::sin(yaw) * p.y, -std::sin(yaw) * p.x + std::cos(yaw) * p.y};
}

float smoothstep(float from, float to, float x) {
  const float t = glm::clamp((x - from) / (to - from), 0.0F, 1.0F);
  return t * t * (3 - 2 * t);
}

/// From the rectangle of half extents `half` about the origin; 0 inside.
float outside(const glm::vec2& p, const glm::vec2& half) {
  return glm::length(glm::max(glm::abs(p) - half, glm::vec2(0)));
}

float share(const WorldPlan::Level& level, const glm::vec2& p) {
  const float away = outside(turned(p - level.middle, -level.yaw), level.half);
  return 1 - smoothstep(level.flat_m, level.blend_m, away);
}

/// Sizes and rooms, but for place and height.
HousePlan plan_house(std::uint32_t seed, std::uint32_t key, float widest_m, bool two_storeys) {
  Draw draw(seed + 31, key);
  HousePlan house;
  house.key = key;
  house.width_m = draw.between(two_storeys ? 8.9F : 7.4F, std::min(widest_m, 10.6F));
  house.depth_m = draw.between(8.2F, 10.2F);
  house.storeys = two_storeys ? 2 : 1;
  house.room_m = draw.between(2.5F, 2.85F);
  const glm::vec2 half = house.inner_half();
  const float side = draw.between(0, 1) < 0.5F ? -1.0F : 1.0F;
  house.partition_z = half.y - draw.between(0.54F, 0.6F) * 2 * half.y;
  house.inner_x = side * (half.x - draw.between(1.15F, 1.35F));
  house.divide_x = side * draw.between(-0.2F, half.x - 2.75F);
  house.door_x = draw.between(-1, 1) * (half.x - 1.3F);
  house.stairs_low_x = side * (1.05F - half.x);
  house.stairs_high_x = house.stairs_low_x + side * kFlight_m;
  house.stairs_z = house.partition_z + HousePlan::kPartition_m / 2 + HousePlan::kStairs_m / 2;
  return house;
}

std::vector<Street> plan_streets(std::uint32_t seed, std::uint32_t axis) {
  constexpr float kApart_m = 52;
  std::vector<Street> streets;
  for (std::uint32_t i = 0; i < WorldPlan::kStreets; ++i) {
    const bool main = i == 1;
    const float shift = (main ? 4.0F : 9.0F) * (random01(seed, 100 + axis, i) - 0.5F);
    const float half = main ? 4.2F : 2.7F + 0.7F * random01(seed, 110 + axis, i);
    streets.push_back({kApart_m * (static_cast<float>(i) - 1) + shift, half});
  }
  return streets;
}

}  // namespace

float HousePlan::aisle_z() const {
  const float free_from = partition_z + kPartition_m / 2 + (storeys > 1 ? kStairs_m : 0);
  return free_from + 0.65F;
}

glm::mat4 HousePlan::world_from_house() const {
  return glm::rotate(glm::translate(glm::mat4(1), {place.x, floor_m, place.y}), yaw, glm::vec3(0, 1, 0));
}

glm::vec3 HousePlan::to_world(const glm::vec3& house) const {
  return world_from_house() * glm::vec4(house, 1);
}

Rect WorldPlan::block(std::size_t i, std::size_t j) const {
  const auto low = [](const std::vector<Street>& streets, std::size_t k) {
    return k == 0 ? -kHalf_m : streets[k - 1].middle_m + streets[k - 1].half_m + kPavement_m;
  };
  const auto high = [](const std::vector<Street>& streets, std::size_t k) {
    return k == kStreets ? kHalf_m : streets[k].middle_m - streets[k].half_m - kPavement_m;
  };
  return {{low(along_z, i), low(along_x, j)}, {high(along_z, i), high(along_x, j)}};
}

Zone WorldPlan::zone(const glm::vec2& p) const {
  float nearest = 1e9F;  // outside of carriageways
  for (const Street& street : along_z) nearest = std::min(nearest, std::abs(p.x - street.middle_m) - street.half_m);
  for (const Street& street : along_x) nearest = std::min(nearest, std::abs(p.y - street.middle_m) - street.half_m);
  return nearest < 0 ? Zone::Carriageway : nearest < kPavement_m ? Zone::Pavement : Zone::Lawn;
}

float WorldPlan::terrain_m(const glm::vec2& p) const {
  constexpr glm::ivec2 kPeriod{256, 256};
  const glm::vec2 positive = p + 512.0F;
  const float rim = std::pow(std::pow(std::abs(p.x), 6.0F) + std::pow(std::abs(p.y), 6.0F), 1 / 6.0F);
  return 3.4F * (noise(seed + 1, positive / 71.0F, kPeriod) - 0.5F) +
         0.8F * (noise(seed + 2, positive / 27.0F, kPeriod) - 0.5F) + 6.5F * smoothstep(kHalf_m - 20, kHalf_m + 4, rim);
}

float WorldPlan::ground_m(const glm::vec2& p) const {
  float least_natural = 1, sum = 0, level_m = 0;
  for (const Level& level : levels) {
    const glm::vec2 away = glm::abs(p - level.middle);
    if (std::max(away.x, away.y) > glm::length(level.half) + level.blend_m) continue;
    const float part = share(level, p);
    least_natural = std::min(least_natural, 1 - part);
    sum += part;
    level_m += part * level.height_m;
  }
  const float natural = terrain_m(p);
  const float smooth = sum > 0 ? glm::mix(level_m / sum, natural, least_natural) : natural;
  // Lawns are bumpy, but not at their edges.
  float from_street = 1e9F;
  for (const Street& street : along_z)
    from_street = std::min(from_street, std::abs(p.x - street.middle_m) - street.half_m);
  for (const Street& street : along_x)
    from_street = std::min(from_street, std::abs(p.y - street.middle_m) - street.half_m);
  const float lawn = smoothstep(kPavement_m, kPavement_m + 2, from_street);
  return smooth + 0.16F * lawn * least_natural * (noise(seed + 3, (p + 512.0F) / 3.1F, {1024, 1024}) - 0.5F);
}

float WorldPlan::stand_m(const glm::vec2& p) const {
  return ground_m(p) - (zone(p) == Zone::Carriageway ? kKerb_m : 0);
}

bool WorldPlan::near_house(const glm::vec2& p, float away_m) const {
  return std::ranges::any_of(houses, [&](const HousePlan& house) {
    return outside(turned(p - house.place, -house.yaw), {house.width_m / 2, house.depth_m / 2}) < away_m;
  });
}

WorldPlan plan_world(std::uint32_t seed) {
  constexpr float kLot_m = 13, kBetween_m = 4.2F, kRim_m = 17;
  WorldPlan plan;
  plan.seed = seed;
  plan.along_z = plan_streets(seed, 0);
  plan.along_x = plan_streets(seed, 1);

  // Rows of lots along the streets that go along x. The world's rim is left to the trees.
  std::uint32_t key = 0;
  for (std::size_t i = 0; i < WorldPlan::kBlocks; ++i) {
    for (std::size_t j = 0; j < WorldPlan::kBlocks; ++j) {
      if (i == plan.park_x && j == plan.park_z) continue;
      Rect block = plan.block(i, j);
      if (i == 0) block.low.x += kRim_m;
      if (i + 1 == WorldPlan::kBlocks) block.high.x -= kRim_m;
      for (const bool faces_high : {false, true}) {
        if (faces_high ? j == WorldPlan::kStreets : j == 0) continue;
        const auto lots = static_cast<std::uint32_t>(block.size().x / kLot_m);
        const float lot_m = block.size().x / static_cast<float>(lots);
        const bool inner = (i == 1 || i == 2) && (j == 1 || j == 2);
        for (std::uint32_t lot = 0; lot < lots; ++lot) {
          ++key;
          Draw draw(seed + 17, key);
          if (draw.between(0, 1) < 0.12F && !inner) continue;  // a garden without a house
          const bool two_storeys = draw.between(0, 1) < 0.45F || (inner && lot == 1);
          HousePlan house = plan_house(seed, key, lot_m - kBetween_m, two_storeys);
          const float back_m = draw.between(4.2F, 6) + house.depth_m / 2;
          const float slack = (lot_m - kBetween_m - house.width_m) / 2;
          house.place = {block.low.x + (static_cast<float>(lot) + 0.5F) * lot_m + draw.between(-slack, slack),
                         faces_high ? block.high.y - back_m : block.low.y + back_m};
          house.yaw = (faces_high ? 0 : glm::pi<float>()) + draw.between(-0.05F, 0.05F);
          const float height_m = plan.terrain_m(house.place);
          house.floor_m = height_m + HousePlan::kThreshold_m;
          plan.levels.push_back({house.place, house.yaw, {house.width_m / 2, house.depth_m / 2}, 1.1F, 3.2F, height_m});
          plan.houses.push_back(house);
        }
      }
    }
  }
  const glm::vec2 crossing{plan.along_z[1].middle_m, plan.along_x[1].middle_m};
  plan.levels.push_back({crossing, 0, glm::vec2(0), kLevelCrossing_m, kLevelCrossing_m + 4, plan.terrain_m(crossing)});
  return plan;
}

}  // namespace splatbus::sim
