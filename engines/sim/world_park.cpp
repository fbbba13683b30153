#include <array>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <glm/gtc/matrix_transform.hpp>

#include "sim/patterns.h"
#include "sim/world_parts.h"

namespace splatbus::sim {
namespace {

void add_fountain(const Site& site, Draw& draw) {
  const Look stone = site.palette().look(Surface::Plaster, color("#b9b1a3"), draw),
             water = site.palette().look(Surface::Paint, color("#4d8ca3"), draw);
  site.add(lathe(
               std::array<glm::vec2, 7>{
                   {{0, -0.4F}, {2.2F, -0.4F}, {2.3F, 0.45F}, {2.35F, 0.55F}, {1.95F, 0.55F}, {1.9F, 0.2F}, {0, 0.2F}}},
               40, 9),
           stone);
  site.add(lathe(std::array<glm::vec2, 8>{{{0, 0.2F},
                                           {0.4F, 0.2F},
                                           {0.25F, 0.5F},
                                           {0.18F, 1.0F},
                                           {0.9F, 1.3F},
                                           {0.95F, 1.38F},
                                           {0.7F, 1.32F},
                                           {0, 1.25F}}},
                 28, 4),
           stone);
  site.add(cylinder(1.93F, 0.14F, 40), water, moved({0, 0.25F, 0}));
  site.add(lathe(std::array<glm::vec2, 4>{{{0.12F, 1.25F}, {0.1F, 1.5F}, {0.22F, 1.6F}, {0, 1.72F}}}, 18, 2), stone);
}

void add_pavilion(const Site& site, Draw& draw) {
  const Look wood = site.palette().look(Surface::Wood, Palette::near(color("#efe7d6"), 0.15F, draw), draw),
             tiles = site.palette().look(Surface::RoofTile, Palette::near(color("#7d4a3c"), 0.2F, draw), draw);
  const Look floor = site.palette().look(Surface::Boards, color("#a58560"), draw);
  constexpr int kPosts = 8;
  constexpr float kPavilion_m = 2.6F;
  site.add(cylinder(kPavilion_m + 0.3F, 0.7F, kPosts), floor, moved({0, -0.5F, 0}));
  for (int i = 0; i < kPosts; ++i) {
    const float angle = glm::two_pi<float>() * static_cast<float>(i) / kPosts,
                next = glm::two_pi<float>() * static_cast<float>(i + 1) / kPosts;
    const glm::vec3 a(kPavilion_m * std::cos(angle), 0.2F, kPavilion_m * std::sin(angle)),
        b(kPavilion_m * std::cos(next), 0.2F, kPavilion_m * std::sin(next));
    site.add(cylinder(0.08F, 2.4F, 12), wood, moved(a));
    if (i == 0) continue;  // the way in
    const glm::vec3 middle = (a + b) / 2.0F;
    const glm::mat4 rail = moved(middle, -std::atan2(b.z - a.z, b.x - a.x));
    for (const float y : {0.3F, 0.85F})
      site.add(box({glm::distance(a, b), 0.06F, 0.06F}, 1), wood, rail * moved({0, y, 0}));
    for (int k = 0; k < 11; ++k)
      site.add(box({0.03F, 0.55F, 0.03F}, 1), wood,
               rail * moved({glm::distance(a, b) * (static_cast<float>(k) / 10 - 0.5F), 0.57F, 0}));
  }
  site.add(cone(kPavilion_m + 0.6F, 1.7F, kPosts, 12), tiles, moved({0, 2.6F, 0}));
  site.add(cylinder(kPavilion_m + 0.15F, 0.16F, kPosts), wood, moved({0, 2.46F, 0}));
  site.add(sphere(0.16F, 14), wood, moved({0, 4.35F, 0}));
}

void add_playground(const Site& site, Draw& draw) {
  const auto paint = [&](const char* hex) {
    return site.palette().look(Surface::Paint, Palette::near(color(hex), 0.15F, draw), draw);
  };
  const Look red = paint("#c8402f"), blue = paint("#2f6fae"), yellow = paint("#e0b13a"),
             wood = site.palette().look(Surface::Wood, color("#a5794a"), draw);
  const auto rod = [&](const glm::vec3& a, const glm::vec3& b, float radius, const Look& look) {
    const glm::vec3 along = b - a, up = glm::normalize(along),
                    side = glm::normalize(glm::cross(glm::vec3(0.3F, 0.2F, 1), up));
    site.add(cylinder(radius, glm::length(along), 8), look,
             glm::mat4(glm::vec4(side, 0), glm::vec4(up, 0), glm::vec4(glm::cross(side, up), 0), glm::vec4(a, 1)));
  };
  // Swings.
  for (const float x : {-2.0F, 2.0F}) {
    for (const float z : {-0.9F, 0.9F}) rod({x, -0.2F, z}, {x, 2.3F, 0}, 0.05F, red);
  }
  rod({-2.1F, 2.3F, 0}, {2.1F, 2.3F, 0}, 0.05F, red);
  for (const float x : {-1.0F, 0.9F}) {
    for (const float by : {-0.22F, 0.22F}) rod({x + by, 0.55F, 0.1F * x}, {x + by, 2.3F, 0}, 0.012F, blue);
    site.add(box({0.5F, 0.04F, 0.2F}, 1), wood, moved({x, 0.53F, 0.1F * x}));
  }
  // A slide with a ladder.
  for (const float x : {4.2F, 4.9F}) {
    rod({x, -0.2F, -1.6F}, {x, 2.2F, -1.3F}, 0.04F, blue);
    rod({x, 1.55F, -1.2F}, {x, 0.25F, 1.7F}, 0.045F, yellow);
  }
  for (int i = 1; i < 6; ++i)
    rod({4.2F, 0.27F * static_cast<float>(i), -1.56F + 0.033F * static_cast<float>(i)},
        {4.9F, 0.27F * static_cast<float>(i), -1.56F + 0.033F * static_cast<float>(i)}, 0.025F, yellow);
  site.add(box({0.66F, 0.03F, 3.18F}, 1), yellow,
           glm::rotate(moved({4.55F, 0.88F, 0.25F}), glm::radians(24.1F), {1, 0, 0}));
  // A sand pit.
  site.add(box({2.6F, 0.08F, 2.6F}, 1), site.palette().look(Surface::Plaster, color("#d8c08a"), draw),
           moved({-4.8F, 0.02F, 0}));
  for (int side = 0; side < 4; ++side)
    site.add(box({2.8F, 0.3F, 0.12F}, 1), wood,
             moved({-4.8F, 0.02F, 0}, glm::half_pi<float>() * static_cast<float>(side)) * moved({0, 0, 1.36F}));
}

}  // namespace

void add_park(WorldBuilder& builder) {
  const WorldPlan& plan = builder.plan;
  Draw draw(plan.seed + 149, 3);
  const Rect park = plan.block(plan.park_x, plan.park_z);
  const glm::vec2 middle = park.middle() + glm::vec2(draw.between(-2, 2), draw.between(-2, 2));
  const auto site_at = [&](const glm::vec2& p, float yaw, float radius) {
    builder.take(p, radius);
    return Site{builder, {}, moved({p.x, plan.ground_m(p), p.y}, yaw)};
  };
  add_fountain(site_at(middle, 0, 3.2F), draw);
  const glm::vec2 quarter = park.size() / 4.0F;
  add_pavilion(site_at(middle + glm::vec2(-quarter.x, quarter.y), draw.between(0, 6), 3.8F), draw);
  add_playground(site_at(middle + glm::vec2(quarter.x * 0.8F, quarter.y), draw.between(-0.3F, 0.3F), 7), draw);
  // Paths of flags from the corners to the fountain, with benches.
  const Look stone = builder.palette.look(Surface::Paving, color("#b5ab99"), draw);
  for (const glm::vec2& corner :
       {park.low, park.high, glm::vec2(park.low.x, park.high.y), glm::vec2(park.high.x, park.low.y)}) {
    const glm::vec2 way = middle - corner, along = glm::normalize(way), side{-along.y, along.x};
    const float length = glm::length(way) - 3;
    const glm::vec2 shift = side * draw.between(1.4F, 1.9F);
    for (const float at : spaced(0.6F, length, 0.78F)) {
      const glm::vec2 p = corner + along * at + side * (0.6F * std::sin(at * 0.35F));
      if (!builder.is_free(p, 0.5F)) continue;
      const Site flag{builder,
                      {},
                      moved({p.x, plan.ground_m(p), p.y}, -std::atan2(along.y, along.x) + draw.between(-0.12F, 0.12F))};
      for (const float across : {-0.4F, 0.4F})
        flag.add(box({draw.between(0.6F, 0.74F), 0.14F, draw.between(0.66F, 0.76F)}, 1), stone,
                 moved({0, -0.02F, across}));
    }
    for (const float at : spaced(0, length, 1)) builder.take(corner + along * at, 0.9F);
    for (const float share : {0.4F, 0.75F}) {
      const glm::vec2 p = corner + way * share + shift;
      if (!builder.is_free(p, 0.2F)) continue;
      add_bench(site_at(p, std::atan2(-shift.x, -shift.y), 1.1F), draw);
    }
  }
}

}  // namespace splatbus::sim
