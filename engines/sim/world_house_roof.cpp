#include <array>
#include <cmath>
#include <glm/gtc/constants.hpp>

#include "sim/patterns.h"
#include "sim/world_house.h"

namespace splatbus::sim {
namespace {

const auto& roof_tints() {
  static const std::array tints{color("#a5503a"), color("#7b3f34"), color("#6b6f76"), color("#8c6a4e"),
                                color("#b5694a"), color("#4f555c"), color("#7d7f6a")};
  return tints;
}

void add_chimney(const Site& shell, const glm::vec3& foot, float height, Draw& draw) {
  const Look look = shell.palette().look(Surface::Brick, Palette::near(color("#a05a48"), 0.2F, draw), draw);
  const float wide = draw.between(0.5F, 0.75F), deep = draw.between(0.45F, 0.6F);
  shell.add(box({wide, height, deep}, 1), look, moved(foot + glm::vec3(0, height / 2, 0)));
  shell.add(box({wide + 0.12F, 0.1F, deep + 0.12F}, 1), look, moved(foot + glm::vec3(0, height, 0)));
  const Look pot = shell.palette().look(Surface::Plaster, color("#b06a4a"), draw);
  shell.add(cylinder(0.11F, 0.3F, 12), pot, moved(foot + glm::vec3(0, height + 0.05F, 0)));
}

}  // namespace

/// Over eaves with a soffit: two slopes and two gables, or four slopes.
void add_roof(const Site& shell, const HousePlan& house, const Look& wall_look, Draw& draw) {
  const Look tiles = shell.palette().look(Surface::RoofTile, Palette::near(draw.of(roof_tints()), 0.14F, draw), draw);
  const Look trim = shell.palette().look(Surface::Paint, Palette::near(color("#e9e3d3"), 0.2F, draw), draw);
  const float over = draw.between(0.3F, 0.6F), rise = draw.between(0.55F, 0.95F);
  const bool hipped = draw.chance(0.35F), along_z = !hipped && draw.chance(0.35F);
  // In a frame whose x is along the ridge.
  const Site roof = shell.at(
      moved({0, static_cast<float>(house.storeys) * house.storey_m(), 0}, along_z ? glm::half_pi<float>() : 0));
  const float x = (along_z ? house.depth_m : house.width_m) / 2 + over,
              z = (along_z ? house.width_m : house.depth_m) / 2 + over;
  const float low = 0, band = 0.16F, ridge = band + rise * z * 0.9F;
  const float ridge_x = hipped ? std::max(x - 0.95F * z, 0.4F) : x;
  const auto corner = [&](float sx, float y, float sz) { return glm::vec3(sx * x, y, sz * z); };
  roof.add(patch(corner(-1, low, -1), corner(1, low, -1), corner(1, low, 1), corner(-1, low, 1)), trim);
  for (const float side : {-1.0F, 1.0F}) {
    roof.add(
        patch(corner(-side, low, side), corner(side, low, side), corner(side, band, side), corner(-side, band, side)),
        trim);
    roof.add(
        patch(corner(side, low, side), corner(side, low, -side), corner(side, band, -side), corner(side, band, side)),
        trim);
    const glm::vec3 right(side * ridge_x, ridge, 0), left(-side * ridge_x, ridge, 0);
    roof.add(patch(corner(-side, band, side), corner(side, band, side), right, left, 0.9F), tiles);
    roof.add(patch(corner(side, band, side), corner(side, band, -side), right, right, 0.9F),
             hipped ? tiles : wall_look);
  }
  // Tiles along the ridge.
  const int caps = static_cast<int>(2 * ridge_x / 0.4F);
  for (int i = 0; i < caps; ++i) {
    const float at = -ridge_x + 2 * ridge_x * (static_cast<float>(i) + 0.5F) / static_cast<float>(caps);
    roof.add(box({0.36F, 0.1F, 0.22F}, 1), tiles, moved({at, ridge, 0}));
  }
  const float stands = draw.between(-0.5F, 0.5F) * ridge_x, aside = draw.between(0.5F, 1.2F);
  add_chimney(roof, {stands, ridge - 1.4F * aside, aside}, 1.4F * aside + draw.between(0.5F, 0.9F), draw);
  // A gutter of half pipes would be too fine: a ledge and a pipe at a corner.
  const Look pipe = shell.palette().look(Surface::Paint, Palette::near(color("#8c8f90"), 0.2F, draw), draw);
  const float wall_x = (along_z ? house.depth_m : house.width_m) / 2,
              wall_z = (along_z ? house.width_m : house.depth_m) / 2;
  const float height = static_cast<float>(house.storeys) * house.storey_m() + 0.3F;
  roof.add(cylinder(0.045F, height, 8), pipe, moved({wall_x - 0.15F, -height, wall_z + 0.05F}));
}

}  // namespace splatbus::sim
