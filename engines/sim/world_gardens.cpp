#include <algorithm>
#include <array>
#include <cmath>
#include <glm/gtc/constants.hpp>

#include "sim/patterns.h"
#include "sim/world_parts.h"

namespace splatbus::sim {
namespace {

enum class Fence { Pickets, Rails, Hedge, LowWall };

struct FenceLooks {
  Fence kind;
  Look look, cap;
  float height_m;
};

/// A straight piece from a to b on the ground.
void add_fence(WorldBuilder& builder, const FenceLooks& fence, const glm::vec2& a, const glm::vec2& b, Draw& draw) {
  const WorldPlan& plan = builder.plan;
  const float length = glm::distance(a, b);
  if (length < 0.4F) return;
  const float yaw = -std::atan2(b.y - a.y, b.x - a.x);
  const float step = fence.kind == Fence::Pickets ? 0.135F : fence.kind == Fence::Rails ? 1.4F : 0.75F;
  const int count = std::max(1, static_cast<int>(length / step));
  for (int i = 0; i < count; ++i) {
    const float share = (static_cast<float>(i) + 0.5F) / static_cast<float>(count),
                wide = length / static_cast<float>(count);
    const glm::vec2 p = glm::mix(a, b, share);
    const Site site{builder, {}, moved({p.x, plan.ground_m(p), p.y}, yaw)};
    const float h = fence.height_m;
    switch (fence.kind) {
      case Fence::Pickets:
        site.add(box({0.085F, h + 0.2F, 0.02F}, 1), fence.look, moved({0, h / 2 - 0.1F, 0}));
        site.add(pyramid(0.085F, 0.07F), fence.look,
                 moved({0, h, 0}) * glm::mat4(1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0.24F, 0, 0, 0, 0, 1));
        if (i % 8 == 4 || count < 8)
          site.add(box({8 * wide, 0.06F, 0.03F}, 1), fence.look, moved({0, 0.72F * h, -0.025F}));
        if (i % 8 == 0) site.add(box({0.1F, h + 0.3F, 0.1F}, 1), fence.cap, moved({0, h / 2 - 0.08F, -0.07F}));
        break;
      case Fence::Rails:
        site.add(box({0.1F, h + 0.4F, 0.1F}, 1), fence.look, moved({0, h / 2 - 0.15F, 0}));
        for (const float y : {0.35F, 0.65F, 0.92F})
          site.add(box({wide, 0.1F, 0.03F}, 1), fence.cap, moved({0, y * h, 0.065F}));
        break;
      case Fence::Hedge:
        site.add(bumpy_ball({0.62F * wide, 0.56F * h, 0.36F}, 0.22F, 10, draw), fence.look,
                 moved({0, 0.48F * h, 0}, draw.between(-0.1F, 0.1F)));
        break;
      default:
        site.add(box({wide + 0.01F, 0.55F * h + 0.4F, 0.2F}, 1), fence.look, moved({0, 0.275F * h - 0.2F, 0}));
        site.add(box({wide + 0.01F, 0.06F, 0.28F}, 1), fence.cap, moved({0, 0.55F * h + 0.03F, 0}));
    }
  }
}

FenceLooks fence_looks(const Palette& palette, Draw& draw) {
  static const std::array paints{color("#efebe0"), color("#7d5a3c"), color("#4b6a55"), color("#a9a395"),
                                 color("#5b7288")};
  const auto kind = static_cast<Fence>(draw.below(4));
  const glm::vec3 paint = Palette::near(draw.of(paints), 0.12F, draw);
  const float height = draw.between(0.75F, 1.05F);
  if (kind == Fence::Hedge) {
    Look look = palette.look(Surface::Leaves, Palette::near(color("#5f8c42"), 0.22F, draw), draw);
    look.uneven = 0.3F;
    return {kind, look, look, height};
  }
  if (kind == Fence::LowWall)
    return {kind,
            palette.look(draw.chance(0.5F) ? Surface::Brick : Surface::Plaster,
                         Palette::near(color("#b08468"), 0.25F, draw), draw),
            palette.look(Surface::Paving, color("#d0c9bb"), draw), height};
  return {kind, palette.look(Surface::Wood, paint, draw),
          palette.look(Surface::Wood, Palette::near(paint, 0.15F, draw), draw), height};
}

void add_flowers(WorldBuilder& builder, const HousePlan& house, Draw& draw) {
  // Beds before the front wall, on both sides of the door.
  const Look stalk = builder.palette.look(Surface::Leaves, color("#5d8a3f"), draw);
  for (int i = 0; i < 26; ++i) {
    const float x = draw.between(-0.5F, 0.5F) * (house.width_m - 0.8F);
    if (std::abs(x - house.door_x) < 1.25F) continue;
    const glm::vec3 at = house.to_world({x, 0, house.depth_m / 2 + draw.between(0.25F, 0.75F)});
    const glm::vec2 p{at.x, at.z};
    const Site site{builder, {}, moved({p.x, builder.plan.ground_m(p), p.y})};
    const float height = draw.between(0.15F, 0.45F);
    site.add(cone(0.05F, height, 5), stalk);
    const Look flower = builder.palette.look(
        Surface::Paint,
        glm::clamp(glm::vec3(draw.between(0.3F, 1), draw.between(0.05F, 0.8F), draw.between(0.05F, 0.8F)), 0.0F, 1.0F),
        draw);
    site.add(bumpy_ball(glm::vec3(draw.between(0.05F, 0.1F)), 0.5F, 8, draw), flower, moved({0, height, 0}));
  }
}

}  // namespace

void add_gardens(WorldBuilder& builder) {
  const WorldPlan& plan = builder.plan;
  for (const HousePlan& house : plan.houses) {
    Draw draw(plan.seed + 113, house.key);
    const auto block = [&] {
      for (std::size_t i = 0; i < WorldPlan::kBlocks; ++i) {
        for (std::size_t j = 0; j < WorldPlan::kBlocks; ++j) {
          if (plan.block(i, j).holds(house.place)) return plan.block(i, j);
        }
      }
      return Rect{};
    }();
    const bool faces_high = std::abs(house.yaw) < 1;
    const float street_z = faces_high ? block.high.y : block.low.y, inwards = faces_high ? -1.0F : 1.0F;
    const glm::vec3 door = house.to_world({house.door_x, 0, house.depth_m / 2 + 1.2F});
    // Stepping stones to the door.
    Look stone = builder.palette.look(Surface::Paving, Palette::near(color("#b8b0a2"), 0.2F, draw), draw);
    const glm::vec3 sill = house.to_world({house.door_x, 0, house.depth_m / 2 + 0.3F});
    const float way = std::abs(sill.z - street_z);
    const int stones = static_cast<int>(way / 0.62F);
    for (int i = 0; i < stones; ++i) {
      const float share = (static_cast<float>(i) + 0.5F) / static_cast<float>(stones);
      const glm::vec2 p{glm::mix(door.x, sill.x, share * share) + draw.between(-0.08F, 0.08F),
                        glm::mix(street_z, sill.z, share)};
      const Site site{builder, {}, moved({p.x, plan.ground_m(p), p.y}, draw.between(-0.2F, 0.2F))};
      site.add(bumpy_ball({draw.between(0.36F, 0.46F), 0.05F, draw.between(0.22F, 0.3F)}, 0.18F, 12, draw), stone);
      builder.take(p, 0.6F);
    }
    add_flowers(builder, house, draw);
    // A fence along the street with a gap before the door, and back along the lot's sides.
    const FenceLooks fence = fence_looks(builder.palette, draw);
    const float z = street_z + inwards * 0.2F, half = house.width_m / 2 + draw.between(1.3F, 1.75F), gap = 0.85F;
    const float left = std::max(house.place.x - half, block.low.x + 0.2F),
                right = std::min(house.place.x + half, block.high.x - 0.2F);
    add_fence(builder, fence, {left, z}, {door.x - gap, z}, draw);
    add_fence(builder, fence, {door.x + gap, z}, {right, z}, draw);
    const float back_z = z + inwards * draw.between(5, 13);
    for (const float x : {left, right}) add_fence(builder, fence, {x, z}, {x, back_z}, draw);
    for (const float share : spaced(0, 1, 0.05F)) {
      builder.take({glm::mix(left, right, share), z}, 0.4F);
      for (const float x : {left, right}) builder.take({x, glm::mix(z, back_z, share)}, 0.4F);
    }
  }
}

}  // namespace splatbus::sim
