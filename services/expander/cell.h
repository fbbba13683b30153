#pragma once

#include <cstdint>

#include "math/portable.h"
#include "model/page_kernels.h"

namespace splatbus::expander {

inline constexpr unsigned kCellBits = 21;    ///< of a coordinate at level 0
inline constexpr unsigned kReportLevel = 3;  ///< whose cells have edges of cell_size_m
inline constexpr unsigned kLevels = 20;      ///< each with cells of twice the edge
inline constexpr std::uint64_t kNoCell = ~std::uint64_t{0};

/// A cell of the octree over the world, or over one moving object. Its coordinates count edges along the frame's axes,
/// in metres of the world: an object's own units do not matter. Of the levels, kReportLevel has cells that are centred
/// at multiples of their edge, so that a floor at height 0 lies in the middle of its cells and not on their border.
struct CellKey {
  std::uint32_t object_id = 0xFFFFFFFF;  ///< 0: the world
  std::uint32_t level = 0xFFFFFFFF;
  std::uint64_t code = kNoCell;  ///< Morton code of x, y and z, kCellBits - level each, offset by half their range

  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER bool none() const { return code == kNoCell; }
};

SPLATBUS_PORTABLE bool operator==(const CellKey& a, const CellKey& b) {
  return a.object_id == b.object_id && a.level == b.level && a.code == b.code;
}
/// By frame, level and place; what has no cell comes last.
SPLATBUS_PORTABLE bool operator<(const CellKey& a, const CellKey& b) {
  if (a.object_id != b.object_id) return a.object_id < b.object_id;
  return a.level != b.level ? a.level < b.level : a.code < b.code;
}

struct CellHash {
  [[nodiscard]] std::size_t operator()(const CellKey& key) const {
    // The finaliser of MurmurHash3.
    std::uint64_t h = key.code ^ (std::uint64_t{key.object_id} << 32U) ^ (std::uint64_t{key.level} << 59U);
    h = (h ^ h >> 33U) * 0xff51afd7ed558ccdU;
    h = (h ^ h >> 33U) * 0xc4ceb9fe1a85ec53U;
    return h ^ h >> 33U;
  }
};

struct CellCoordinates {
  std::int64_t x = 0, y = 0, z = 0;
};

/// Every third bit, together.
SPLATBUS_PORTABLE std::uint64_t gather_bits(std::uint64_t x) {
  x &= 0x1249249249249249U;
  x = (x | x >> 2U) & 0x10c30c30c30c30c3U;
  x = (x | x >> 4U) & 0x100f00f00f00f00fU;
  x = (x | x >> 8U) & 0x1f0000ff0000ffU;
  x = (x | x >> 16U) & 0x1f00000000ffffU;
  return (x | x >> 32U) & 0x1fffffU;
}

SPLATBUS_PORTABLE std::int64_t half_range(unsigned level) {
  return std::int64_t{1} << (kCellBits - 1 - level);
}

/// No cell for what lies outside of what keys can name.
SPLATBUS_PORTABLE CellKey pack_cell(const CellCoordinates& at, std::uint32_t object_id, unsigned level) {
  const std::int64_t half = half_range(level);
  if (at.x < -half || at.x >= half || at.y < -half || at.y >= half || at.z < -half || at.z >= half) return {};
  return {object_id, level,
          model::spread_bits(static_cast<std::uint64_t>(at.x + half)) |
              model::spread_bits(static_cast<std::uint64_t>(at.y + half)) << 1U |
              model::spread_bits(static_cast<std::uint64_t>(at.z + half)) << 2U};
}

SPLATBUS_PORTABLE CellCoordinates unpack_cell(const CellKey& key) {
  const std::int64_t half = half_range(key.level);
  return {static_cast<std::int64_t>(gather_bits(key.code)) - half,
          static_cast<std::int64_t>(gather_bits(key.code >> 1U)) - half,
          static_cast<std::int64_t>(gather_bits(key.code >> 2U)) - half};
}

/// Edge of a level's cells, of which those of kReportLevel have `cell_size_m`.
SPLATBUS_PORTABLE float edge_of(unsigned level, float cell_size_m) {
  return cell_size_m / static_cast<float>(1U << kReportLevel) * static_cast<float>(1U << level);
}

/// The lowest level whose cells' edges are at least that long, or the last.
SPLATBUS_PORTABLE unsigned level_of(float edge_m, float cell_size_m) {
  unsigned level = 0;
  while (level + 1 < kLevels && edge_of(level, cell_size_m) < edge_m) ++level;
  return level;
}

/// The cell that holds a point of a frame, in metres of the world; none for NaN and for what is too far.
SPLATBUS_PORTABLE CellKey cell_at(const math::Vec3& point_m, std::uint32_t object_id, float cell_size_m,
                                  unsigned level = kReportLevel) {
  constexpr float kLimit = 1U << kCellBits, kShift = 1U << (kReportLevel - 1);
  const float edge_m = edge_of(0, cell_size_m);
  const math::Vec3 at{floorf(point_m.x / edge_m + kShift), floorf(point_m.y / edge_m + kShift),
                      floorf(point_m.z / edge_m + kShift)};
  if (!(fabsf(at.x) < kLimit && fabsf(at.y) < kLimit && fabsf(at.z) < kLimit)) return {};
  const CellKey finest =
      pack_cell({static_cast<std::int64_t>(at.x), static_cast<std::int64_t>(at.y), static_cast<std::int64_t>(at.z)},
                object_id, 0);
  return finest.none() ? finest : CellKey{object_id, level, finest.code >> 3U * level};
}

/// The cell of a higher level that holds this one.
SPLATBUS_PORTABLE CellKey parent_of(const CellKey& key, unsigned level) {
  return {key.object_id, level, key.code >> 3U * (level - key.level)};
}
/// The first cell of a lower level in this one; all others follow in their order, before the first of `next_of(key)`.
SPLATBUS_PORTABLE CellKey first_in(const CellKey& key, unsigned level) {
  return {key.object_id, level, key.code << 3U * (key.level - level)};
}
SPLATBUS_PORTABLE CellKey next_of(const CellKey& key) {
  return {key.object_id, key.level, key.code + 1};
}

/// The neighbour at an offset of whole cells; none at the border of what keys can name.
SPLATBUS_PORTABLE CellKey neighbour(const CellKey& key, int dx, int dy, int dz) {
  const CellCoordinates at = unpack_cell(key);
  return pack_cell({at.x + dx, at.y + dy, at.z + dz}, key.object_id, key.level);
}

/// In the frame, metres of the world.
SPLATBUS_PORTABLE math::Vec3 cell_centre(const CellKey& key, float cell_size_m) {
  const float edge_m = edge_of(key.level, cell_size_m);
  const float shift_m = edge_of(0, cell_size_m) * static_cast<float>(1U << (kReportLevel - 1));
  const CellCoordinates at = unpack_cell(key);
  const auto middle = [&](std::int64_t coordinate) {
    return (static_cast<float>(coordinate) + 0.5F) * edge_m - shift_m;
  };
  return {middle(at.x), middle(at.y), middle(at.z)};
}

}  // namespace splatbus::expander
