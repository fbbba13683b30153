#include "sim/field.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/gtc/matrix_transform.hpp>
#include <utility>

#include "sim/patterns.h"
#include "sim/random.h"

namespace splatbus::sim {
namespace {

constexpr float kSide_m = 200, kPost_m = 0.1F;
constexpr float kFar_m = 14, kNear_m = 2.6F;  // between neighbours
constexpr int kFarCells = 14, kNearCells = 7;

glm::mat4 at(const glm::vec3& place, float turn = 0) {
  return glm::rotate(glm::translate(glm::mat4(1), place), turn, glm::vec3(0, 1, 0));
}

/// Posts and boxes in turns, one in each cell of a square grid about the origin, away from its middle.
void plant(Scene& scene, std::uint32_t seed, int cells, float cell_m, float greatest_m) {
  const int materials = static_cast<int>(scene.materials.size()) - 1;
  for (int cell = 0; cell < cells * cells; ++cell) {
    const auto of_cell = static_cast<std::uint32_t>(cell);
    const auto middle = [&](int index, std::uint32_t use) {
      return cell_m * (static_cast<float>(index) - 0.5F * static_cast<float>(cells - 1) +
                       0.6F * (random01(seed, of_cell, use) - 0.5F));
    };
    const float x = middle(cell % cells, 1), z = middle(cell / cells, 2);
    if (std::max(std::abs(x), std::abs(z)) < 0.6F * cell_m) continue;
    const int material = 1 + cell % materials;
    const float turn = 6.28F * random01(seed, of_cell, 3);
    if (cell % 2 == 0) {
      const float height = 1.2F + 0.8F * random01(seed, of_cell, 4);
      scene.add("post", box({kPost_m, height, kPost_m}, 2), material, at({x, height / 2, z}, turn));
    } else {
      const float side = 0.4F + (greatest_m - 0.4F) * random01(seed, of_cell, 4);
      scene.add("box", box({side, side, side}), material, at({x, side / 2, z}, turn));
    }
  }
}

}  // namespace

Scene make_field(std::uint32_t seed) {
  Scene scene;
  scene
      .add("field", box({kSide_m, 0.1F, kSide_m}, 0.5F), checker(8, color("#b9b08c"), color("#8f9a6a")),
           at({0, -0.05F, 0}))
      .casts_shadow = false;
  scene.add("near post", box({kPost_m, 1.5F, kPost_m}, 2),
            stripes(std::array{color("#c8452f"), color("#f3ead2")}, 2, false), at({1, 0.75F, 0}));
  for (Image image :
       {bricks(seed + 1, 6, color("#b5665a"), color("#cfc4b5")), wood(seed + 2, color("#c99a5b"), color("#7d4f28")),
        checker(4, color("#2f6fae"), color("#dfe3e6")), dots(5, color("#3d9a5f"), color("#e6dfcf"), 0.3F)}) {
    scene.materials.push_back({.image = static_cast<int>(scene.images.size())});
    scene.images.push_back(std::move(image));
  }
  plant(scene, seed, kNearCells, kNear_m, 0.9F);
  plant(scene, seed + 7, kFarCells, kFar_m, 2.5F);
  return scene;
}

}  // namespace splatbus::sim
