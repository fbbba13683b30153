#pragma once

#include <cstdint>

// Cell ids as plain integers: also compiled into kernels, so free of other headers.
namespace splatbus::expander {

/// A cell of the grid, packed as messages carry it. Cells are centred at multiples of the cell size, so that a floor at
/// height 0 lies in the middle of its cells and not on their border.
///
/// World cells: bit 63 is 0, then 21 bits each of x, y, z. Cells of a moving object, in the object's frame: bit 63 is
/// 1, then the low 18 bits of the object's id, then 15 bits each of x, y, z. Coordinates are offset by half their
/// range.
using CellId = std::uint64_t;

inline constexpr CellId kObjectCell = CellId{1} << 63U;
/// No cell. The one cell that would be packed so, the farthest of objects whose id ends in 18 ones, is never named.
inline constexpr CellId kNoCell = ~CellId{0};

inline constexpr unsigned kWorldCellBits = 21, kObjectCellBits = 15;
inline constexpr std::uint32_t kObjectIdMask = (1U << 18U) - 1;

struct CellCoordinates {
  std::int64_t x, y, z;
};

[[nodiscard]] constexpr unsigned cell_bits(CellId cell) {
  return (cell & kObjectCell) != 0 ? kObjectCellBits : kWorldCellBits;
}

/// The bits above the coordinates.
[[nodiscard]] constexpr CellId cell_prefix(bool local, std::uint32_t object_id) {
  return local ? kObjectCell | static_cast<CellId>(object_id & kObjectIdMask) << (3 * kObjectCellBits) : 0;
}
[[nodiscard]] constexpr CellId prefix_of(CellId cell) {
  return (cell & kObjectCell) != 0 ? cell >> (3 * kObjectCellBits) << (3 * kObjectCellBits) : 0;
}

/// kNoCell for what ids cannot name.
[[nodiscard]] constexpr CellId pack_cell(const CellCoordinates& at, unsigned bits, CellId prefix) {
  const std::int64_t half = std::int64_t{1} << (bits - 1);
  if (at.x < -half || at.x >= half || at.y < -half || at.y >= half || at.z < -half || at.z >= half) return kNoCell;
  return prefix | static_cast<CellId>(at.x + half) << (2 * bits) | static_cast<CellId>(at.y + half) << bits |
         static_cast<CellId>(at.z + half);
}

/// From whole numbers, which may be infinite or NaN.
[[nodiscard]] constexpr CellId pack_floored(float x, float y, float z, CellId prefix) {
  constexpr float kLargest = 1 << kWorldCellBits;
  const bool named = x > -kLargest && x < kLargest && y > -kLargest && y < kLargest && z > -kLargest && z < kLargest;
  if (!named) return kNoCell;
  const CellCoordinates at{static_cast<std::int64_t>(x), static_cast<std::int64_t>(y), static_cast<std::int64_t>(z)};
  return pack_cell(at, cell_bits(prefix), prefix);
}

[[nodiscard]] constexpr CellCoordinates unpack_cell(CellId cell) {
  const unsigned bits = cell_bits(cell);
  const CellId mask = (CellId{1} << bits) - 1;
  const std::int64_t half = std::int64_t{1} << (bits - 1);
  return {static_cast<std::int64_t>(cell >> (2 * bits) & mask) - half,
          static_cast<std::int64_t>(cell >> bits & mask) - half, static_cast<std::int64_t>(cell & mask) - half};
}

/// The neighbour at an offset of whole cells; kNoCell at the border of what ids can name.
[[nodiscard]] constexpr CellId neighbour_cell(CellId cell, int dx, int dy, int dz) {
  const CellCoordinates at = unpack_cell(cell);
  return pack_cell({at.x + dx, at.y + dy, at.z + dz}, cell_bits(cell), prefix_of(cell));
}

}  // namespace splatbus::expander
