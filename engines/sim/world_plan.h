#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <vector>

namespace splatbus::sim {

/// A straight street through the whole world, along x or along z.
struct Street {
  float middle_m, half_m;  ///< of its carriageway: z of a street along x, x of one along z
};

/// An upright rectangle in plan, metres.
struct Rect {
  glm::vec2 low{0}, high{0};
  [[nodiscard]] glm::vec2 middle() const { return (low + high) / 2.0F; }
  [[nodiscard]] glm::vec2 size() const { return high - low; }
  [[nodiscard]] Rect grown(float by_m) const { return {low - by_m, high + by_m}; }
  [[nodiscard]] bool overlaps(const Rect& other) const {
    return low.x < other.high.x && other.low.x < high.x && low.y < other.high.y && other.low.y < high.y;
  }
  [[nodiscard]] bool holds(const glm::vec2& p) const {
    return p.x >= low.x && p.x <= high.x && p.y >= low.y && p.y <= high.y;
  }
};

/// A house. Its frame: x to the right of who looks at it from the street, y up from its ground floor, z towards the
/// street; its middle is the origin. Outer walls are kWall_m thick, inner ones kPartition_m.
///
/// The front room takes the whole width and has the front door, at door_x; the partition at partition_z has one inner
/// door, at inner_x, to one of two back rooms, which the divide at divide_x separates; that has a door at its middle.
/// A house of two storeys has stairs along the partition in the front room, and the same rooms above.
struct HousePlan {
  std::uint32_t key = 0;  ///< for random numbers
  glm::vec2 place{0};     ///< world x, z
  float yaw = 0;          ///< about y
  float floor_m = 0;      ///< world y of the ground floor
  float width_m = 0, depth_m = 0;
  int storeys = 1;
  float room_m = 2.6F;  ///< from floor to ceiling
  float door_x = 0, partition_z = 0, inner_x = 0, divide_x = 0;
  float stairs_low_x = 0, stairs_high_x = 0, stairs_z = 0;  ///< ends and middle of the flight

  static constexpr float kWall_m = 0.28F, kPartition_m = 0.12F, kSlab_m = 0.24F;
  static constexpr float kDoor_m = 1.1F, kInnerDoor_m = 1.0F, kDoorHigh_m = 2.12F, kStairs_m = 1.0F;
  static constexpr float kThreshold_m = 0.15F;  ///< of the ground floor above the ground outside

  [[nodiscard]] float storey_m() const { return room_m + kSlab_m; }
  [[nodiscard]] glm::vec2 inner_half() const { return {width_m / 2 - kWall_m, depth_m / 2 - kWall_m}; }
  [[nodiscard]] float back_z() const { return (partition_z - inner_half().y) / 2; }  ///< middle of the back rooms
  [[nodiscard]] float aisle_z() const;  ///< of the way through the front room, before the stairs
  [[nodiscard]] glm::mat4 world_from_house() const;
  [[nodiscard]] glm::vec3 to_world(const glm::vec3& house) const;
};

enum class Zone { Carriageway, Pavement, Lawn };

/// Where everything stands in the world of a seed, in metres about the origin: a small town in a shallow bowl.
struct WorldPlan {
  static constexpr float kHalf_m = 112;  ///< it reaches from -kHalf_m to kHalf_m in x and z
  static constexpr float kPavement_m = 2.4F, kKerb_m = 0.12F;
  static constexpr std::size_t kStreets = 3, kBlocks = kStreets + 1;

  std::uint32_t seed = 0;
  std::vector<Street> along_z, along_x;  ///< by ascending middle
  std::vector<HousePlan> houses;         ///< at least 40
  std::size_t park_x = 1, park_z = 2;    ///< the block that has no houses

  /// The lawn between pavements, block (i, j) from -x, -z.
  [[nodiscard]] Rect block(std::size_t i, std::size_t j) const;
  [[nodiscard]] Zone zone(const glm::vec2& p) const;
  /// World y of the ground (of the pavement, where there are streets).
  [[nodiscard]] float ground_m(const glm::vec2& p) const;
  /// World y of what one stands on out of doors: the ground, kKerb_m lower on a carriageway.
  [[nodiscard]] float stand_m(const glm::vec2& p) const;
  /// Whether something of this size about p would stand in a house or less than `away_m` from it.
  [[nodiscard]] bool near_house(const glm::vec2& p, float away_m) const;

  /// A place that is level: a turned rectangle and flat_m about it, ending after blend_m.
  struct Level {
    glm::vec2 middle;
    float yaw;
    glm::vec2 half;
    float flat_m, blend_m, height_m;
  };
  std::vector<Level> levels;

 private:
  [[nodiscard]] float terrain_m(const glm::vec2& p) const;
  friend WorldPlan plan_world(std::uint32_t seed);
};

/// Places on the floors, in the world: from the front door through every room, upstairs too, and back to it.
[[nodiscard]] std::vector<glm::vec3> tour_of(const HousePlan& house);

/// The same for the same seed.
[[nodiscard]] WorldPlan plan_world(std::uint32_t seed);

}  // namespace splatbus::sim
