#include <algorithm>
#include <array>
#include <cmath>

#include "sim/paint.h"
#include "sim/patterns.h"
#include "sim/world_parts.h"

namespace splatbus::sim {
namespace {

constexpr float kLawnCell_m = 0.8F;
constexpr float kMarkingHigh_m = 0.012F;

/// Edges of streets and pavements along one axis, and points between them.
std::vector<float> lines(const std::vector<Street>& streets) {
  std::vector<float> edges{-WorldPlan::kHalf_m, WorldPlan::kHalf_m};
  for (const Street& street : streets) {
    for (const float side : {-1.0F, 1.0F}) {
      edges.push_back(street.middle_m + side * street.half_m);
      edges.push_back(street.middle_m + side * (street.half_m + WorldPlan::kPavement_m));
    }
  }
  std::ranges::sort(edges);
  std::vector<float> result{edges.front()};
  for (std::size_t i = 1; i < edges.size(); ++i) {
    const int parts = static_cast<int>(std::ceil((edges[i] - edges[i - 1]) / kLawnCell_m));
    for (int k = 1; k <= parts; ++k)
      result.push_back(glm::mix(edges[i - 1], edges[i], static_cast<float>(k) / static_cast<float>(parts)));
  }
  return result;
}

class Ground {
 public:
  explicit Ground(WorldBuilder& builder) : builder_(builder), plan_(builder.plan) {
    Draw draw(plan_.seed + 71, 1);
    looks_[0] = builder.palette.look(Surface::Asphalt, color("#8d8b88"), draw);
    looks_[1] = builder.palette.look(Surface::Paving, color("#c9c1b2"), draw);
    looks_[2] = builder.palette.look(Surface::Grass, color("#8fb05a"), draw);
    kerb_ = builder.palette.look(Surface::Paving, color("#d5d0c4"), draw);
    paint_ = builder.palette.look(Surface::Paint, color("#f2efe6"), draw);
    for (Look& look : looks_) look.uneven = 0;  // they have tints of their own
  }

  void add() {
    const std::vector<float> xs = lines(plan_.along_z), zs = lines(plan_.along_x);
    for (std::size_t j = 0; j + 1 < zs.size(); ++j) {
      for (std::size_t i = 0; i + 1 < xs.size(); ++i) add_cell({{xs[i], zs[j]}, {xs[i + 1], zs[j + 1]}});
    }
    add_markings();
  }

 private:
  [[nodiscard]] glm::vec3 on(const glm::vec2& p, float above_m) const {
    return {p.x, plan_.ground_m(p) + above_m, p.y};
  }
  [[nodiscard]] glm::vec3 normal(const glm::vec2& p) const {
    constexpr float kStep_m = 0.25F;
    const float x = plan_.ground_m(p + glm::vec2(kStep_m, 0)) - plan_.ground_m(p - glm::vec2(kStep_m, 0));
    const float z = plan_.ground_m(p + glm::vec2(0, kStep_m)) - plan_.ground_m(p - glm::vec2(0, kStep_m));
    return glm::normalize(glm::vec3(-x, 2 * kStep_m, -z));
  }
  /// Wandering shades and coordinates, so that nobody sees a pattern come again.
  [[nodiscard]] Vertex vertex(const glm::vec2& p, Zone zone) const {
    const auto value = [&](std::uint32_t use, float size_m) {
      return noise(plan_.seed + use, (p + 512.0F) / size_m, {2048, 2048});
    };
    Vertex made{on(p, zone == Zone::Carriageway ? -WorldPlan::kKerb_m : 0), normal(p), p, {}};
    if (zone == Zone::Lawn) made.uv += 2.2F * glm::vec2(value(41, 5.3F), value(42, 4.7F));
    const float shade = 0.72F + 0.34F * value(43, 9) + 0.2F * value(44, 1.9F);
    glm::vec3 tint = looks_.at(static_cast<std::size_t>(zone)).tint * shade;
    if (zone == Zone::Lawn) tint *= glm::mix(glm::vec3(1.25F, 1.02F, 0.75F), glm::vec3(0.85F, 1, 0.85F), value(45, 13));
    made.tint = {glm::clamp(tint, 0.0F, 1.0F) * 255.0F + 0.5F, 255};
    return made;
  }

  void add_cell(const Rect& cell) {
    const Zone zone = plan_.zone(cell.middle());
    Mesh mesh;
    for (const glm::vec2& p :
         {cell.low, glm::vec2(cell.high.x, cell.low.y), cell.high, glm::vec2(cell.low.x, cell.high.y)})
      mesh.vertices.push_back(vertex(p, zone));
    add_triangle(mesh, 0, 1, 2);
    add_triangle(mesh, 0, 2, 3);
    builder_.add_tinted(mesh, looks_.at(static_cast<std::size_t>(zone)), cell.middle());
    if (zone != Zone::Carriageway) return;
    // Kerbs, where a neighbour is higher.
    const std::array<std::array<glm::vec2, 3>, 4> sides{{{cell.low, {cell.low.x, cell.high.y}, {-1, 0}},
                                                         {cell.high, {cell.high.x, cell.low.y}, {1, 0}},
                                                         {glm::vec2(cell.high.x, cell.low.y), cell.low, {0, -1}},
                                                         {glm::vec2(cell.low.x, cell.high.y), cell.high, {0, 1}}}};
    for (const auto& [a, b, out] : sides) {
      if (plan_.zone((a + b) / 2.0F + 0.1F * out) == Zone::Carriageway) continue;
      if (std::max(std::abs(a.x + b.x), std::abs(a.y + b.y)) / 2 > WorldPlan::kHalf_m - 0.1F) continue;
      builder_.add_at(patch(on(b, -WorldPlan::kKerb_m), on(a, -WorldPlan::kKerb_m), on(a, 0), on(b, 0), 9), kerb_,
                      (a + b) / 2.0F);
      // The kerbstone's top lies a little above the pavement.
      builder_.add_at(patch(on(b, 0.004F), on(a, 0.004F), on(a + 0.16F * out, 0.004F), on(b + 0.16F * out, 0.004F), 9),
                      kerb_, (a + b) / 2.0F);
    }
  }

  /// A painted rectangle on the carriageway.
  void mark(const Rect& rect) {
    constexpr float kAbove_m = kMarkingHigh_m - WorldPlan::kKerb_m;
    builder_.add_at(patch(on({rect.low.x, rect.high.y}, kAbove_m), on(rect.high, kAbove_m),
                          on({rect.high.x, rect.low.y}, kAbove_m), on(rect.low, kAbove_m), 0.7F),
                    paint_, rect.middle());
  }

  void add_markings() {
    constexpr float kLine_m = 0.13F, kDash_m = 1.6F, kGap_m = 2.4F, kBar_m = 0.5F;
    const auto is_crossing = [&](const std::vector<Street>& others, float at, float margin) {
      return std::ranges::any_of(
          others, [&](const Street& other) { return std::abs(at - other.middle_m) < other.half_m + margin; });
    };
    for (const bool along_x : {true, false}) {
      const std::vector<Street>& others = along_x ? plan_.along_z : plan_.along_x;
      const auto rect = [&](float from, float to, float middle, float half) {
        const glm::vec2 a(from, middle - half), b(to, middle + half);
        return along_x ? Rect{a, b} : Rect{{a.y, a.x}, {b.y, b.x}};
      };
      for (const Street& street : along_x ? plan_.along_x : plan_.along_z) {
        for (const float at : spaced(-WorldPlan::kHalf_m + 1, WorldPlan::kHalf_m - 2, kDash_m + kGap_m)) {
          if (!is_crossing(others, at + kDash_m / 2, 5.5F)) mark(rect(at, at + kDash_m, street.middle_m, kLine_m / 2));
        }
        // Zebra crossings beside each crossing, where the pavements go on.
        for (const Street& other : others) {
          for (const float side : {-1.0F, 1.0F}) {
            const float middle = other.middle_m + side * (other.half_m + WorldPlan::kPavement_m * 0.5F);
            for (const float across : spaced(-street.half_m + 0.45F, street.half_m - kBar_m, 2 * kBar_m)) {
              mark(rect(middle - 1.1F, middle + 1.1F, street.middle_m + across + kBar_m / 2, kBar_m / 2));
            }
          }
        }
      }
    }
  }

  WorldBuilder& builder_;
  const WorldPlan& plan_;
  std::array<Look, 3> looks_;
  Look kerb_, paint_;
};

}  // namespace

void add_ground(WorldBuilder& builder) {
  Ground(builder).add();
}

}  // namespace splatbus::sim
