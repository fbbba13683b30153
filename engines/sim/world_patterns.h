#pragma once

#include <cstdint>

#include "sim/scene.h"

namespace splatbus::sim {

// Pale procedural textures for tints: square, repeating without a seam, the same bytes for the same arguments.

[[nodiscard]] Image brick_wall(std::uint32_t seed, int rows, float contrast);
[[nodiscard]] Image plaster(std::uint32_t seed, float contrast);
[[nodiscard]] Image siding(std::uint32_t seed, int boards, bool upright);
[[nodiscard]] Image roof_tiles(std::uint32_t seed, int rows);
[[nodiscard]] Image wallpaper(std::uint32_t seed, int kind);  ///< kind 0 to 7
[[nodiscard]] Image floor_boards(std::uint32_t seed, int rows);
[[nodiscard]] Image floor_tiles(std::uint32_t seed, int tiles, bool checked);
[[nodiscard]] Image grass(std::uint32_t seed);
[[nodiscard]] Image asphalt(std::uint32_t seed);
[[nodiscard]] Image paving(std::uint32_t seed, int stones);
[[nodiscard]] Image bark(std::uint32_t seed);
[[nodiscard]] Image leaves(std::uint32_t seed);
[[nodiscard]] Image fabric(std::uint32_t seed, int kind);  ///< kind 0 to 3
[[nodiscard]] Image wood_grain(std::uint32_t seed);
[[nodiscard]] Image book_spines(std::uint32_t seed);  ///< with colours of its own

/// Atlases of `cells` x `cells` pictures, none like another, with colours of their own.
[[nodiscard]] Image picture_atlas(std::uint32_t seed, std::uint32_t cells);
[[nodiscard]] Image carpet_atlas(std::uint32_t seed, std::uint32_t cells);

}  // namespace splatbus::sim
