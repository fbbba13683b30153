#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <span>
#include <string>
#include <vector>

#include "sim/scene.h"

namespace splatbus::sim {

/// "#e0a030", an sRGB colour, as linear RGB.
[[nodiscard]] glm::vec3 color(const char* hex);

// Procedural textures: square, repeating without a seam unless said otherwise, the same bytes for the same arguments.

[[nodiscard]] Image checker(int squares, const glm::vec3& a, const glm::vec3& b);
/// Bands across v, or along the diagonal.
[[nodiscard]] Image stripes(std::span<const glm::vec3> colors, int repeats, bool diagonal);
[[nodiscard]] Image dots(int count, const glm::vec3& ground, const glm::vec3& dot, float radius);
[[nodiscard]] Image wood(std::uint32_t seed, const glm::vec3& light, const glm::vec3& dark);
/// From `top` to `bottom`, with thin rings of `ring`; repeats in u only.
[[nodiscard]] Image gradient(const glm::vec3& top, const glm::vec3& bottom, const glm::vec3& ring, int rings);
/// Bricks of changing tone with joints.
[[nodiscard]] Image bricks(std::uint32_t seed, int rows, const glm::vec3& brick, const glm::vec3& joint);
/// A framed letter or word; does not repeat.
[[nodiscard]] Image letter(const std::string& text, const glm::vec3& ground, const glm::vec3& ink);
/// A page of lines of words; does not repeat.
[[nodiscard]] Image page(std::uint32_t seed, const glm::vec3& paper, const glm::vec3& ink);
/// Planks around a round rug with a pattern; does not repeat.
[[nodiscard]] Image floor_with_rug(std::uint32_t seed);

}  // namespace splatbus::sim
