#pragma once

#include <cstdint>

#include "math/portable.h"

namespace splatbus::expander {

inline constexpr unsigned kCellBits = 21;  ///< of a coordinate
inline constexpr std::uint64_t kNoCell = ~std::uint64_t{0};

/// A cell of the regular grid over the world, or over one moving object in the object's frame. Cells are centred at
/// multiples of the cell size, so that a floor at height 0 lies in the middle of its cells and not on their border.
struct CellKey {
  std::uint32_t object_id = 0xFFFFFFFF;  ///< 0: the world
  std::uint64_t cell = kNoCell;          ///< kCellBits each of x, y, z, offset by half their range

  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER bool none() const { return cell == kNoCell; }
};

SPLATBUS_PORTABLE bool operator==(const CellKey& a, const CellKey& b) {
  return a.object_id == b.object_id && a.cell == b.cell;
}
/// By frame, then by place; what has no cell comes last.
SPLATBUS_PORTABLE bool operator<(const CellKey& a, const CellKey& b) {
  return a.object_id != b.object_id ? a.object_id < b.object_id : a.cell < b.cell;
}

struct CellCoordinates {
  std::int64_t x = 0, y = 0, z = 0;
};

/// No cell for what lies outside of what keys can name.
SPLATBUS_PORTABLE CellKey pack_cell(const CellCoordinates& at, std::uint32_t object_id) {
  constexpr std::int64_t kHalf = std::int64_t{1} << (kCellBits - 1);
  if (at.x < -kHalf || at.x >= kHalf || at.y < -kHalf || at.y >= kHalf || at.z < -kHalf || at.z >= kHalf) return {};
  return {object_id, static_cast<std::uint64_t>(at.x + kHalf) << (2 * kCellBits) |
                         static_cast<std::uint64_t>(at.y + kHalf) << kCellBits |
                         static_cast<std::uint64_t>(at.z + kHalf)};
}

SPLATBUS_PORTABLE CellCoordinates unpack_cell(const CellKey& key) {
  constexpr std::uint64_t kMask = (std::uint64_t{1} << kCellBits) - 1;
  constexpr std::int64_t kHalf = std::int64_t{1} << (kCellBits - 1);
  return {static_cast<std::int64_t>(key.cell >> (2 * kCellBits) & kMask) - kHalf,
          static_cast<std::int64_t>(key.cell >> kCellBits & kMask) - kHalf,
          static_cast<std::int64_t>(key.cell & kMask) - kHalf};
}

/// The cell that holds a point of the object's frame; none for NaN and for what is too far.
SPLATBUS_PORTABLE CellKey cell_at(const math::Vec3& point, std::uint32_t object_id, float cell_size_m) {
  constexpr float kLimit = 1U << kCellBits;
  const math::Vec3 at{floorf(point.x / cell_size_m + 0.5F), floorf(point.y / cell_size_m + 0.5F),
                      floorf(point.z / cell_size_m + 0.5F)};
  if (!(fabsf(at.x) < kLimit && fabsf(at.y) < kLimit && fabsf(at.z) < kLimit)) return {};
  return pack_cell({static_cast<std::int64_t>(at.x), static_cast<std::int64_t>(at.y), static_cast<std::int64_t>(at.z)},
                   object_id);
}

/// The neighbour at an offset of whole cells; none at the border of what keys can name.
SPLATBUS_PORTABLE CellKey neighbour(const CellKey& key, int dx, int dy, int dz) {
  const CellCoordinates at = unpack_cell(key);
  return pack_cell({at.x + dx, at.y + dy, at.z + dz}, key.object_id);
}

/// In the object's frame.
SPLATBUS_PORTABLE math::Vec3 cell_centre(const CellKey& key, float cell_size_m) {
  const CellCoordinates at = unpack_cell(key);
  return math::Vec3{static_cast<float>(at.x), static_cast<float>(at.y), static_cast<float>(at.z)} * cell_size_m;
}

}  // namespace splatbus::expander
