#include <algorithm>
#include <array>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <glm/gtc/matrix_transform.hpp>

#include "sim/paint.h"
#include "sim/patterns.h"
#include "sim/world_parts.h"

namespace splatbus::sim {
namespace {

Look bark_look(const Site& site, Draw& draw) {
  static const std::array tints{color("#8a7a66"), color("#6d5a48"), color("#a49a8c"), color("#7b6a55")};
  return site.palette().look(Surface::Bark, Palette::near(draw.of(tints), 0.2F, draw), draw);
}

Look leaf_look(const Site& site, Draw& draw) {
  static const std::array tints{color("#6fa044"), color("#5a8c3c"), color("#86a84a"), color("#4f7f3f"),
                                color("#9db04e"), color("#b9953f"), color("#a8603a")};
  // The last two are rare.
  const std::size_t tint = draw.chance(0.9F) ? draw.below(5) : 5 + draw.below(2);
  Look look = site.palette().look(Surface::Leaves, Palette::near(tints.at(tint), 0.18F, draw), draw);
  look.uneven = 0.3F;
  return look;
}

/// A tapered limb from a to b.
void add_limb(const Site& site, const Look& look, const glm::vec3& a, const glm::vec3& b, float thick_a, float thick_b,
              int segments) {
  const glm::vec3 along = b - a;
  const float length = glm::length(along);
  const Mesh limb =
      lathe(std::array<glm::vec2, 3>{{{thick_a, 0}, {thick_b, length}, {0, length + 0.4F * thick_b}}}, segments, 2);
  const glm::vec3 up = along / length;
  const glm::vec3 side =
      glm::normalize(glm::cross(std::abs(up.y) > 0.95F ? glm::vec3(1, 0, 0) : glm::vec3(0, 1, 0), up));
  site.add(limb, look,
           glm::mat4(glm::vec4(side, 0), glm::vec4(up, 0), glm::vec4(glm::cross(side, up), 0), glm::vec4(a, 1)));
}

}  // namespace

Mesh bumpy_ball(const glm::vec3& radius, float bumps, int segments, Draw& draw) {
  Mesh mesh = sphere(1, segments, 3);
  const auto seed = static_cast<std::uint32_t>(draw.between(0, 1e6F));
  for (Vertex& vertex : mesh.vertices) {
    const glm::vec3 p = vertex.position;
    // By place, so that the seam stays closed; the poles' and seam's vertices are there several times.
    const glm::vec3 q = glm::round(p * 512.0F) / 512.0F;
    const float wave = noise(seed, 2.1F * glm::vec2(q.x + 0.7F * q.y, q.z - 0.6F * q.y) + 64.0F, {128, 128}) +
                       0.6F * noise(seed + 1, 4.7F * glm::vec2(q.x - 0.8F * q.y, q.z + 0.7F * q.y) + 64.0F, {256, 256});
    vertex.position = p * radius * (1 + bumps * (wave - 0.8F));
    vertex.uv *= std::max(radius.x, radius.z) * 2.0F;
    vertex.normal = glm::normalize(p / radius);
  }
  return mesh;
}

void add_leafy_tree(const Site& site, float height, Draw& draw) {
  const Look bark = bark_look(site, draw), leaf = leaf_look(site, draw);
  const float thick = height * draw.between(0.022F, 0.034F), crown_from = height * draw.between(0.32F, 0.42F);
  const float crown = height * draw.between(0.24F, 0.34F);
  const glm::vec3 bend(draw.between(-0.06F, 0.06F) * height, 0, draw.between(-0.06F, 0.06F) * height);
  const glm::vec3 knee = glm::vec3(0, crown_from, 0) + 0.5F * bend, top = glm::vec3(0, height * 0.72F, 0) + bend;
  add_limb(site, bark, {0, -0.4F, 0}, {0, 0.25F, 0}, 1.5F * thick, 1.05F * thick, 14);
  add_limb(site, bark, {0, 0.2F, 0}, knee, 1.05F * thick, 0.8F * thick, 12);
  add_limb(site, bark, knee, top, 0.8F * thick, 0.3F * thick, 10);
  const int branches = 5 + static_cast<int>(draw.below(4));
  std::vector<glm::vec3> ends{top + glm::vec3(0, 0.3F * crown, 0)};
  for (int i = 0; i < branches; ++i) {
    const float turn =
        glm::two_pi<float>() * (static_cast<float>(i) + draw.between(0, 0.7F)) / static_cast<float>(branches);
    const glm::vec3 from = glm::mix(knee, top, draw.between(0, 0.85F));
    const glm::vec3 to =
        from + crown * draw.between(0.6F, 0.95F) * glm::vec3(std::cos(turn), draw.between(0.35F, 0.8F), std::sin(turn));
    add_limb(site, bark, from, to, 0.35F * thick, 0.12F * thick, 8);
    ends.push_back(to);
  }
  for (const glm::vec3& end : ends) {
    const int clumps = 2 + static_cast<int>(draw.below(2));
    for (int i = 0; i < clumps; ++i) {
      const float size = crown * draw.between(0.34F, 0.52F);
      glm::vec3 at =
          end + 0.5F * crown * glm::vec3(draw.between(-1, 1), draw.between(-0.5F, 0.7F), draw.between(-1, 1));
      at.y = std::max(at.y, crown_from + 0.75F * size);
      site.add(
          bumpy_ball(size * glm::vec3(draw.between(0.9F, 1.2F), draw.between(0.65F, 0.9F), draw.between(0.9F, 1.2F)),
                     0.42F, 10, draw),
          leaf, moved(at, draw.between(0, 6.28F)));
    }
  }
}

void add_conifer(const Site& site, float height, Draw& draw) {
  const Look bark = bark_look(site, draw);
  Look leaf = site.palette().look(Surface::Leaves, Palette::near(color("#3f6b45"), 0.2F, draw), draw);
  leaf.uneven = 0.25F;
  add_limb(site, bark, {0, -0.4F, 0}, {0, height * 0.9F, 0}, height * 0.022F, 0.02F, 10);
  const int tiers = 6 + static_cast<int>(draw.below(4));
  for (int i = 0; i < tiers; ++i) {
    const float share = static_cast<float>(i) / static_cast<float>(tiers);
    const float radius = height * draw.between(0.19F, 0.22F) * (1 - share) + 0.18F,
                low = height * (0.14F + 0.76F * share), high = height * 0.27F * (1 - 0.5F * share);
    // A cone whose rim is in points.
    Mesh tier = lathe(
        std::array<glm::vec2, 4>{{{0, 0.22F * high}, {radius, 0}, {0.45F * radius, 0.5F * high}, {0, high}}}, 20, 4);
    for (Vertex& vertex : tier.vertices) {
      const float out = std::hypot(vertex.position.x, vertex.position.z) / radius,
                  angle = std::atan2(vertex.position.z, vertex.position.x);
      const float ragged = 1 - 0.22F * out * (0.5F + 0.5F * std::cos(10 * angle));
      vertex.position = {vertex.position.x * ragged,
                         vertex.position.y - 0.12F * high * out * (0.5F + 0.5F * std::cos(10 * angle + 1)),
                         vertex.position.z * ragged};
      vertex.uv *= radius;
    }
    site.add(tier, leaf, moved({0, low, 0}, draw.between(0, 6.28F)));
  }
}

void add_bush(const Site& site, float radius, Draw& draw) {
  const Look leaf = leaf_look(site, draw);
  for (int i = 0; i < 3; ++i) {
    const float size = radius * draw.between(0.6F, 0.9F);
    site.add(bumpy_ball(size * glm::vec3(1, draw.between(0.7F, 1), 1), 0.35F, 12, draw), leaf,
             moved({0.5F * radius * draw.between(-1, 1), 0.5F * size, 0.5F * radius * draw.between(-1, 1)},
                   draw.between(0, 6.28F)));
  }
}

void add_trees(WorldBuilder& builder) {
  const WorldPlan& plan = builder.plan;
  // One try in each cell of a grid: gardens and park have few, the rim many.
  constexpr float kTreeCell_m = 6.2F;
  const int cells = static_cast<int>(2 * WorldPlan::kHalf_m / kTreeCell_m);
  for (int i = 0; i < cells * cells; ++i) {
    Draw draw(plan.seed + 91, static_cast<std::uint32_t>(i));
    const glm::vec2 p =
        -WorldPlan::kHalf_m + kTreeCell_m * (glm::vec2(i % cells, i / cells) +
                                             glm::vec2(draw.between(0.15F, 0.85F), draw.between(0.15F, 0.85F)));
    if (plan.zone(p) != Zone::Lawn) continue;
    const bool rim = std::max(std::abs(p.x), std::abs(p.y)) > WorldPlan::kHalf_m - 15;
    const bool park = plan.block(plan.park_x, plan.park_z).holds(p);
    const float kind = draw.between(0, 1);
    const float away = kind < 0.72F ? 2.7F : 1.3F;
    if (!draw.chance(rim    ? 0.75F
                     : park ? 0.5F
                            : 0.38F) ||
        plan.near_house(p, away) || !builder.is_free(p, kind < 0.72F ? 2.2F : 0.9F))
      continue;
    builder.take(p, kind < 0.72F ? 1.2F : 0.8F);
    const Site site{builder, {}, moved({p.x, plan.ground_m(p), p.y})};
    if (kind < 0.47F) {
      add_leafy_tree(site, draw.between(5, 9), draw);
    } else if (kind < 0.72F) {
      add_conifer(site, draw.between(4.5F, 9.5F), draw);
    } else {
      add_bush(site, draw.between(0.5F, 0.95F), draw);
    }
  }
}

}  // namespace splatbus::sim
