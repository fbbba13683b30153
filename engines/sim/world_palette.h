#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <vector>

#include "sim/random.h"
#include "sim/scene.h"

namespace splatbus::sim {

/// What a surface of the world is made of. Most patterns are pale, and get their colour from a tint.
enum class Surface : std::uint8_t {
  Brick,
  Plaster,
  Siding,
  RoofTile,
  Wallpaper,
  Boards,
  Tiles,
  Grass,
  Asphalt,
  Paving,
  Bark,
  Leaves,
  Fabric,
  Wood,
  Paint,
  Books,
  Carpet,   ///< an atlas
  Picture,  ///< an atlas
  Count
};

/// How a mesh whose texture coordinates are in metres is to look.
struct Look {
  int material = 0;
  glm::vec3 tint{1};       ///< linear
  float repeat_per_m = 1;  ///< of the texture
  glm::vec2 shift{0};      ///< of texture coordinates
  float uneven = 0;        ///< how much the tint differs from place to place
};

/// The images and materials of the world in a scene.
class Palette {
 public:
  Palette(Scene& scene, std::uint32_t seed);

  /// One of the surface's patterns, shifted at random. Not of an atlas.
  [[nodiscard]] Look look(Surface surface, const glm::vec3& tint, Draw& draw) const;
  /// A whole cell of an atlas, for texture coordinates in [0, 1].
  [[nodiscard]] Look cell(Surface atlas, Draw& draw) const;
  /// Near a colour.
  [[nodiscard]] static glm::vec3 near(const glm::vec3& linear, float spread, Draw& draw);

  static constexpr std::uint32_t kPictureCells = 16, kCarpetCells = 8;  ///< a side

 private:
  struct Pattern {
    int material;
    float repeat_per_m;
  };
  std::array<std::vector<Pattern>, static_cast<std::size_t>(Surface::Count)> patterns_;
};

}  // namespace splatbus::sim
