#include <algorithm>
#include <array>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <glm/gtc/matrix_transform.hpp>

#include "sim/patterns.h"
#include "sim/world_life.h"
#include "sim/world_parts.h"

namespace splatbus::sim {
namespace {

Look metal(const Site& site, const glm::vec3& tint, Draw& draw) {
  return site.palette().look(Surface::Paint, Palette::near(tint, 0.2F, draw), draw);
}

/// Its arm reaches towards +z, over the carriageway.
void add_lamp_post(const Site& site, Draw& draw) {
  const Look look = metal(site, color("#3d4a45"), draw), glass = metal(site, color("#f4edd0"), draw);
  const float height = draw.between(4.2F, 5.4F), arm = draw.between(0.7F, 1.2F);
  site.add(lathe(std::array<glm::vec2, 7>{{{0, 0},
                                           {0.14F, 0},
                                           {0.14F, 0.35F},
                                           {0.08F, 0.5F},
                                           {0.055F, 1.2F},
                                           {0.045F, height},
                                           {0, height + 0.05F}}},
                 14, 1),
           look);
  site.add(box({0.05F, 0.05F, arm}, 1), look, moved({0, height - 0.05F, arm / 2}));
  site.add(lathe(std::array<glm::vec2, 5>{{{0, -0.16F}, {0.12F, -0.12F}, {0.16F, 0}, {0.06F, 0.1F}, {0, 0.1F}}}, 14, 1),
           look, moved({0, height - 0.05F, arm}));
  site.add(sphere(0.09F, 12), glass, moved({0, height - 0.19F, arm}));
}

void add_bin(const Site& site, Draw& draw) {
  const Look look = metal(site, draw.chance(0.5F) ? color("#3f6b4a") : color("#5b5f63"), draw),
             rim = metal(site, color("#26292b"), draw);
  const float radius = draw.between(0.2F, 0.27F), height = draw.between(0.75F, 0.95F);
  site.add(lathe(
               std::array<glm::vec2, 5>{
                   {{0, 0}, {0.85F * radius, 0}, {radius, height}, {0.8F * radius, height}, {0, 0.75F * height}}},
               18, 3),
           look);
  site.add(torus(radius, 0.025F, 20, 7), rim, moved({0, height, 0}));
  for (int i = 0; i < 9; ++i)
    site.add(box({0.03F, height * 0.85F, 0.015F}, 1), rim,
             moved({0, 0, 0}, 0.698F * static_cast<float>(i)) * moved({0, height * 0.48F, 0.96F * radius}));
}

void add_letter_box(const Site& site, Draw& draw) {
  const Look look = metal(site, draw.chance(0.6F) ? color("#b8322b") : color("#d9a92f"), draw),
             dark = metal(site, color("#222222"), draw);
  site.add(cylinder(0.22F, 1.15F, 20), look);
  site.add(sphere(0.24F, 18), look, glm::scale(moved({0, 1.15F, 0}), {1, 0.5F, 1}));
  site.add(box({0.24F, 0.035F, 0.03F}, 1), dark, moved({0, 0.98F, 0.215F}));
}

void add_sign(const Site& site, Draw& draw) {
  const Look pole = metal(site, color("#8d9297"), draw),
             rim = metal(site, draw.chance(0.5F) ? color("#b8332c") : color("#2c5aa0"), draw),
             face = metal(site, color("#f2f0ea"), draw);
  site.add(cylinder(0.035F, 2.5F, 10), pole);
  const glm::mat4 plate = glm::rotate(moved({0, 2.35F, 0.03F}), glm::half_pi<float>(), {1, 0, 0});
  const int sides = draw.chance(0.5F) ? 24 : draw.chance(0.5F) ? 3 : 8;
  site.add(cylinder(0.32F, 0.025F, sides), rim, plate);
  site.add(cylinder(0.23F, 0.04F, sides), face, plate);
  site.add(box({0.26F, draw.between(0.05F, 0.12F), 0.05F}, 1), rim, moved({0, 2.35F, 0.05F}));
}

void add_hydrant(const Site& site, Draw& draw) {
  const Look look = metal(site, color("#c23a2b"), draw);
  site.add(lathe(std::array<glm::vec2, 8>{{{0, 0},
                                           {0.15F, 0},
                                           {0.15F, 0.06F},
                                           {0.1F, 0.08F},
                                           {0.1F, 0.5F},
                                           {0.13F, 0.53F},
                                           {0.08F, 0.64F},
                                           {0, 0.68F}}},
                 16, 1),
           look);
  for (const float side : {-1.0F, 1.0F})
    site.add(cylinder(0.05F, 0.13F, 10), look,
             glm::rotate(moved({side * 0.08F, 0.4F, 0}), -side * glm::half_pi<float>(), {0, 0, 1}));
}

/// Along x.
void add_car(const Site& site, Draw& draw) {
  static const std::array paints{color("#8f2f2b"), color("#2f4f7f"), color("#d7d5cf"), color("#3a3d40"),
                                 color("#6f8a5a"), color("#c9a24a"), color("#6d7a86"), color("#5a2f4d")};
  const Look paint = metal(site, draw.of(paints), draw), glass = metal(site, color("#2b3840"), draw),
             tyre = metal(site, color("#1d1d1f"), draw), hub = metal(site, color("#b9bcbf"), draw);
  const float length = draw.between(3.6F, 4.5F), width = draw.between(1.6F, 1.78F), belt = draw.between(0.78F, 0.9F),
              roof = belt + draw.between(0.5F, 0.62F);
  const float front = length / 2, wheel = 0.31F;
  // The side's outline, and a narrower one for the cabin.
  const auto prism = [&](const std::vector<glm::vec2>& outline, float half_low, float half_high, const Look& look) {
    Mesh mesh;
    float low = 1e9F, high = -1e9F;
    for (const glm::vec2& p : outline) {
      low = std::min(low, p.y);
      high = std::max(high, p.y);
    }
    const auto half = [&](float y) { return glm::mix(half_low, half_high, (y - low) / (high - low)); };
    for (std::size_t i = 0; i < outline.size(); ++i) {
      const glm::vec2 a = outline[i], b = outline[(i + 1) % outline.size()];
      append(mesh,
             patch({a.x, a.y, half(a.y)}, {a.x, a.y, -half(a.y)}, {b.x, b.y, -half(b.y)}, {b.x, b.y, half(b.y)}, 9));
    }
    glm::vec2 middle(0);
    for (const glm::vec2& p : outline) middle += p / static_cast<float>(outline.size());
    for (const float side : {-1.0F, 1.0F}) {
      for (std::size_t i = 0; i < outline.size(); ++i) {
        glm::vec2 a = outline[i], b = outline[(i + 1) % outline.size()];
        if (side < 0) std::swap(a, b);
        const glm::vec3 m{middle, side * half(middle.y)}, p{a, side * half(a.y)}, q{b, side * half(b.y)};
        append(mesh, patch(p, q, m, m, 9));
      }
    }
    site.add(mesh, look);
  };
  const float bonnet = draw.between(0.9F, 1.15F), boot = draw.between(0.1F, 0.7F), w = width / 2;
  // Counter-clockwise as seen from +z.
  prism({{-front, 0.28F},
         {front, 0.28F},
         {front, 0.58F},
         {front - 0.12F, belt - 0.1F},
         {front - bonnet, belt},
         {-front + boot, belt},
         {-front + 0.05F, belt - 0.08F}},
        w, w - 0.06F, paint);
  prism({{-front + boot * 0.7F + 0.1F, belt - 0.02F},
         {front - bonnet + 0.05F, belt - 0.02F},
         {front - bonnet - 0.55F, roof},
         {-front + boot + 0.35F, roof}},
        w - 0.08F, w - 0.24F, glass);
  prism({{-front + boot + 0.3F, roof - 0.03F},
         {front - bonnet - 0.5F, roof - 0.03F},
         {front - bonnet - 0.6F, roof + 0.03F},
         {-front + boot + 0.4F, roof + 0.03F}},
        w - 0.22F, w - 0.26F, paint);
  for (const float x : {-0.62F, 0.62F}) {
    for (const float side : {-1.0F, 1.0F}) {
      const glm::mat4 turned =
          glm::rotate(moved({x * front, wheel, side * (w - 0.16F)}), side * glm::half_pi<float>(), {1, 0, 0});
      site.add(cylinder(wheel, 0.18F, 20), tyre, turned);
      site.add(cylinder(0.55F * wheel, 0.19F, 14), hub, turned);
    }
  }
  for (const float side : {-1.0F, 1.0F}) {
    site.add(sphere(0.1F, 10), hub, moved({front - 0.05F, 0.62F, side * (w - 0.25F)}));
    site.add(box({0.04F, 0.12F, 0.2F}, 1), metal(site, color("#a02622"), draw),
             moved({-front + 0.02F, 0.66F, side * (w - 0.25F)}));
  }
  for (const float x : {-front - 0.02F, front + 0.02F})
    site.add(box({0.1F, 0.12F, width - 0.1F}, 1), tyre, moved({x, 0.36F, 0}));
}

}  // namespace

void add_bench(const Site& site, Draw& draw) {
  const Look wood = site.palette().look(Surface::Wood, Palette::near(color("#8a5f3a"), 0.25F, draw), draw),
             iron = metal(site, color("#2f3533"), draw);
  const float length = draw.between(1.4F, 1.9F);
  for (int i = 0; i < 4; ++i)
    site.add(box({length, 0.035F, 0.09F}, 1), wood, moved({0, 0.44F, -0.15F + 0.11F * static_cast<float>(i)}));
  for (int i = 0; i < 3; ++i)
    site.add(box({length, 0.09F, 0.03F}, 1), wood,
             moved({0, 0.58F + 0.13F * static_cast<float>(i), -0.25F - 0.02F * static_cast<float>(i)}));
  for (const float side : {-1.0F, 1.0F}) {
    const float x = side * (length / 2 - 0.15F);
    for (const float z : {-0.2F, 0.18F}) site.add(box({0.05F, 0.62F, 0.05F}, 1), iron, moved({x, 0.11F, z}));
    site.add(box({0.05F, 0.55F, 0.04F}, 1), iron, moved({x, 0.65F, -0.22F}));
    site.add(box({0.05F, 0.04F, 0.45F}, 1), iron, moved({x, 0.62F, 0}));
  }
}

void add_street_things(WorldBuilder& builder) {
  const WorldPlan& plan = builder.plan;
  std::uint32_t key = 0;
  for (const bool along_x : {true, false}) {
    const std::vector<Street>& others = along_x ? plan.along_z : plan.along_x;
    for (const Street& street : along_x ? plan.along_x : plan.along_z) {
      for (const float side : {-1.0F, 1.0F}) {
        for (float at = -WorldPlan::kHalf_m + 6; at < WorldPlan::kHalf_m - 6;) {
          Draw draw(plan.seed + 131, ++key);
          at += draw.between(4.5F, 8);
          const bool at_corner =
              std::ranges::any_of(others, [&](const Street& o) { return std::abs(at - o.middle_m) < o.half_m + 6.5F; });
          if (at_corner) continue;
          const auto place = [&](float from_kerb) {
            const float across = street.middle_m + side * (street.half_m + from_kerb);
            return along_x ? glm::vec2(at, across) : glm::vec2(across, at);
          };
          // Turned with its front to the street: +z of the thing towards the middle.
          const float yaw = along_x ? (side > 0 ? glm::pi<float>() : 0) : side * -glm::half_pi<float>();
          const float kind = draw.between(0, 1);
          const bool parked = kind > 0.68F;
          const glm::vec2 p = place(parked ? -1.05F : kind > 0.52F && kind < 0.6F ? 2.0F : 0.42F);
          const float radius = parked ? 2.4F : 0.45F;
          if (!builder.is_free(p, radius)) continue;
          builder.take(p, radius);
          const Site site{builder, {}, moved({p.x, plan.stand_m(p), p.y}, yaw)};
          if (kind < 0.3F) {
            add_lamp_post(site, draw);
          } else if (kind < 0.38F) {
            add_bin(site, draw);
          } else if (kind < 0.44F) {
            add_letter_box(site, draw);
          } else if (kind < 0.52F) {
            add_sign(site, draw);
          } else if (kind < 0.6F) {
            add_bench(site, draw);
          } else if (kind < 0.68F) {
            add_hydrant(site, draw);
          } else {
            add_car(site.at(moved({0, 0, 0}, draw.chance(0.5F) ? 0.0F : glm::pi<float>())), draw);
            at += 4;
          }
        }
      }
    }
  }
  // What the cube turns above.
  Draw draw(plan.seed + 137, 1);
  const glm::vec2 p = cube_corner(plan);
  builder.take(p, 1.2F);
  builder.take(ball_corner(plan), 1.3F);
  const Site pedestal{builder, {}, moved({p.x, plan.ground_m(p) - 0.3F, p.y})};
  pedestal.add(box({0.7F, kPedestal_m + 0.24F, 0.7F}, 1), builder.palette.look(Surface::Brick, color("#b39a82"), draw),
               moved({0, (kPedestal_m + 0.24F) / 2, 0}));
  pedestal.add(box({0.9F, 0.06F, 0.9F}, 1), builder.palette.look(Surface::Paving, color("#d0c9bb"), draw),
               moved({0, kPedestal_m + 0.27F, 0}));
}

}  // namespace splatbus::sim
