#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <optional>

namespace splatbus::expander {

/// A cell of the grid, packed as messages carry it. Cells are centred at multiples of the cell size, so that a floor at
/// height 0 lies in the middle of its cells and not on their border.
///
/// World cells: bit 63 is 0, then 21 bits each of x, y, z. Cells of a moving object, in the object's frame: bit 63 is
/// 1, then the low 18 bits of the object's id, then 15 bits each of x, y, z. Coordinates are offset by half their
/// range.
using CellId = std::uint64_t;

inline constexpr CellId kObjectCell = CellId{1} << 63U;

/// Where a sample's Gaussian lives: the world, or a moving object.
struct Frame {
  bool local = false;
  std::uint32_t object_id = 0;  ///< when local
};

/// The cell that holds a point of its frame; nullopt when the point lies outside of what ids can name.
[[nodiscard]] std::optional<CellId> cell_at(const glm::vec3& point, const Frame& frame, float cell_size_m);

/// The neighbour at an offset of whole cells; nullopt at the border of what ids can name.
[[nodiscard]] std::optional<CellId> neighbour(CellId cell, int dx, int dy, int dz);

/// The cell's centre in its frame.
[[nodiscard]] glm::vec3 cell_centre(CellId cell, float cell_size_m);

}  // namespace splatbus::expander
