#include <algorithm>
#include <cmath>
#include <utility>

#include "sim/world.h"
#include "sim/world_plan.h"

namespace splatbus::sim {
namespace {

constexpr float kSpacing_m = 0.5F;
constexpr float kBeforeDoor_m = 1.2F;
constexpr float kFromLawn_m = 0.95F;  // of the walk's line on a pavement

/// Points on what one stands on, at most kSpacing_m apart.
class Path {
 public:
  explicit Path(const WorldPlan& plan) : plan_(plan) {}

  /// On, out of doors.
  void along(const glm::vec2& to) {
    if (points_.empty()) points_.push_back(standing(to));
    const glm::vec2 from = plan_place();
    const int steps = static_cast<int>(std::ceil(glm::distance(from, to) / kSpacing_m));
    for (int i = 1; i <= steps; ++i) {
      const glm::vec2 p = glm::mix(from, to, static_cast<float>(i) / static_cast<float>(steps));
      points_.push_back(standing(p));
    }
  }
  /// On in a straight line.
  void straight(const glm::vec3& to) {
    const glm::vec3 from = points_.back();
    const int steps = static_cast<int>(std::ceil(glm::distance(from, to) / kSpacing_m));
    for (int i = 1; i <= steps; ++i)
      points_.push_back(glm::mix(from, to, static_cast<float>(i) / static_cast<float>(steps)));
  }
  [[nodiscard]] glm::vec2 plan_place() const { return {points_.back().x, points_.back().z}; }
  [[nodiscard]] glm::vec3 standing(const glm::vec2& p) const { return {p.x, plan_.stand_m(p), p.y}; }
  [[nodiscard]] float length() const {
    float sum = 0;
    for (std::size_t i = 1; i < points_.size(); ++i) sum += glm::distance(points_[i - 1], points_[i]);
    return sum;
  }

  /// Its first `length_m` metres.
  [[nodiscard]] std::vector<glm::vec3> cut(float length_m) const {
    std::vector<glm::vec3> result{points_.front()};
    for (std::size_t i = 1; i < points_.size() && length_m > 0; ++i) {
      const float step = glm::distance(points_[i - 1], points_[i]);
      if (step > 0) result.push_back(glm::mix(points_[i - 1], points_[i], std::min(1.0F, length_m / step)));
      length_m -= step;
    }
    return result;
  }

 private:
  const WorldPlan& plan_;
  std::vector<glm::vec3> points_;
};

/// Before the door of a house, in its frame: where its path begins to lead straight in.
glm::vec2 before_door(const HousePlan& house, float away_m) {
  const glm::vec3 p = house.to_world({house.door_x, 0, house.depth_m / 2 + away_m});
  return {p.x, p.z};
}

/// From the pavement at `gate` through the rooms, and back.
void visit(Path& path, const HousePlan& house) {
  constexpr float kStep_m = 0.45F;
  const glm::vec2 gate = path.plan_place(), before = before_door(house, kBeforeDoor_m),
                  step = before_door(house, kStep_m);
  path.along(before);
  path.along(step);
  for (const glm::vec3& point : tour_of(house)) path.straight(point);
  path.straight(path.standing(step));
  path.along(before);
  path.along(gate);
}

/// The houses of a block's row, by ascending x.
std::vector<HousePlan> row(const WorldPlan& plan, std::size_t i, std::size_t j, bool faces_high) {
  std::vector<HousePlan> houses;
  const Rect block = plan.block(i, j);
  for (const HousePlan& house : plan.houses) {
    if (block.holds(house.place) && (house.place.y > block.middle().y) == faces_high) houses.push_back(house);
  }
  std::ranges::sort(houses, {}, [](const HousePlan& house) { return house.place.x; });
  return houses;
}

/// A stretch of pavement, and whose doors are along it.
struct Stretch {
  glm::vec2 to;
  std::vector<HousePlan> houses;  ///< in order
};

std::vector<Stretch> round(const WorldPlan& plan) {
  const Rect first = plan.block(1, 1).grown(kFromLawn_m), second = plan.block(2, 1).grown(kFromLawn_m);
  std::vector<HousePlan> out = row(plan, 1, 1, true), back = row(plan, 2, 1, true);
  std::ranges::reverse(out);
  std::ranges::reverse(back);
  return {{{first.low.x, first.high.y}, out},
          {first.low, {}},
          {{first.high.x, first.low.y}, row(plan, 1, 1, false)},
          {second.low, {}},
          {{second.high.x, second.low.y}, row(plan, 2, 1, false)},
          {second.high, {}},
          {{second.low.x, second.high.y}, back},
          {first.high, {}}};
}

struct Walked {
  Path path;
  float last_visit_m = 0;  ///< how long it is by the end of the last visit
};

/// Round two blocks, into the houses whose turns `visited` has.
Walked walk_into(const WorldPlan& plan, const std::vector<bool>& visited) {
  Walked walked{Path(plan)};
  walked.path.along(plan.block(1, 1).grown(kFromLawn_m).high);
  std::size_t turn = 0;
  for (const Stretch& leg : round(plan)) {
    for (const HousePlan& house : leg.houses) {
      if (!visited[turn++]) continue;
      walked.path.along({before_door(house, kBeforeDoor_m).x, walked.path.plan_place().y});
      visit(walked.path, house);
      walked.last_visit_m = walked.path.length();
    }
    walked.path.along(leg.to);
  }
  return walked;
}

}  // namespace

std::vector<glm::vec3> tour_of(const HousePlan& house) {
  std::vector<glm::vec3> points;
  const auto go = [&](float x, float z, int storey) {
    points.push_back(house.to_world({x, static_cast<float>(storey) * house.storey_m(), z}));
  };
  const float other_x = house.divide_x + (house.inner_x > house.divide_x ? -1.2F : 1.2F), aisle_z = house.aisle_z();
  go(house.door_x, house.depth_m / 2 - 0.1F, 0);
  go(house.door_x, aisle_z, 0);
  const auto back_rooms = [&](int storey) {
    go(house.inner_x, house.back_z(), storey);
    go(other_x, house.back_z(), storey);
    go(house.inner_x, house.back_z(), storey);
  };
  go(house.inner_x, aisle_z, 0);
  back_rooms(0);
  go(house.inner_x, aisle_z, 0);
  if (house.storeys > 1) {
    const float low_x = house.stairs_low_x, high_x = house.stairs_high_x, z = house.stairs_z;
    const float foot_x = low_x + (low_x < high_x ? -0.55F : 0.55F);
    const auto climb = [&](bool up) {
      go(up ? foot_x : house.inner_x, up ? aisle_z : z, up ? 0 : 1);
      if (up) go(foot_x, z, 0);
      go(up ? low_x : high_x, z, up ? 0 : 1);
      go(up ? high_x : low_x, z, up ? 1 : 0);
      if (!up) go(foot_x, z, 0);
      go(up ? house.inner_x : foot_x, up ? z : aisle_z, up ? 1 : 0);
    };
    climb(true);
    back_rooms(1);
    climb(false);
  }
  go(house.door_x, aisle_z, 0);
  go(house.door_x, house.depth_m / 2 - 0.1F, 0);
  return points;
}

std::vector<glm::vec3> world_walk(std::uint32_t seed) {
  const WorldPlan plan = plan_world(seed);
  std::vector<HousePlan> houses;
  for (const Stretch& leg : round(plan)) houses.insert(houses.end(), leg.houses.begin(), leg.houses.end());
  std::vector<bool> visited(houses.size(), false);
  // Stairs first, and then as many others, spread over the way, as it has length for.
  const auto stairs = std::ranges::find_if(houses, [](const HousePlan& house) { return house.storeys > 1; });
  const auto stairs_at = static_cast<std::size_t>(stairs - houses.begin());
  visited.at(stairs_at) = true;
  constexpr std::ptrdiff_t kMostVisits = 5;
  for (const std::size_t by : {5U, 3U, 8U, 10U, 6U, 9U, 4U, 2U, 1U, 7U, 11U}) {
    std::vector<bool> more = visited;
    more[(stairs_at + by) % houses.size()] = true;
    if (std::ranges::count(more, true) <= kMostVisits && walk_into(plan, more).last_visit_m <= kWalk_m) visited = more;
  }
  Path path = walk_into(plan, visited).path;
  // What is left leads round the first block again.
  for (const Stretch& leg : round(plan)) {
    if (path.length() < kWalk_m) path.along(leg.to);
  }
  std::vector<glm::vec3> eyes = path.cut(kWalk_m);
  for (glm::vec3& eye : eyes) eye.y += kEyeHeight_m;
  return eyes;
}

}  // namespace splatbus::sim
