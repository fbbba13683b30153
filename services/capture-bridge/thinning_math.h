#pragma once

#include "math/portable.h"

namespace splatbus::capture_bridge {

using math::clamped, math::cross, math::dot, math::is_finite, math::larger, math::length, math::load3, math::load4,
    math::Mat3, math::normalized, math::smaller, math::transformed, math::transposed, math::Vec3, math::Vec4;

/// The cube that Morton codes divide.
struct MortonCube {
  Vec3 low;
  float cells_per_metre = 0;
};

/// Around points between `low` and `high`.
SPLATBUS_PORTABLE MortonCube morton_cube(const Vec3& low, const Vec3& high) {
  constexpr float kCells = 2097151.0F;  // 21 bits an axis
  const Vec3 size = high - low;
  return {low, kCells / larger(larger(size.x, size.y), larger(size.z, 1e-6F))};
}

SPLATBUS_PORTABLE std::uint64_t spread_bits(std::uint64_t v) {
  v = (v | v << 32) & 0x1f00000000ffff;
  v = (v | v << 16) & 0x1f0000ff0000ff;
  v = (v | v << 8) & 0x100f00f00f00f00f;
  v = (v | v << 4) & 0x10c30c30c30c30c3;
  v = (v | v << 2) & 0x1249249249249249;
  return v;
}

SPLATBUS_PORTABLE std::uint64_t morton_code(const MortonCube& cube, const Vec3& point) {
  constexpr float kLastCell = 2097151.0F;
  const Vec3 cell = (point - cube.low) * cube.cells_per_metre;
  // Sizes beyond floats' range make cells that are no number: 0.
  return spread_bits(static_cast<std::uint64_t>(clamped(cell.x, 0, kLastCell))) |
         spread_bits(static_cast<std::uint64_t>(clamped(cell.y, 0, kLastCell))) << 1U |
         spread_bits(static_cast<std::uint64_t>(clamped(cell.z, 0, kLastCell))) << 2U;
}

constexpr int kMortonBits = 63;

/// Shares of a point are fixed-point numbers with this many fractional bits: their sums are the same in any order.
constexpr int kShareBits = 32;
/// Where the sum of shares begins: one half.
constexpr std::uint64_t kFirstShare = std::uint64_t{1} << (kShareBits - 1);

/// Probability of keeping a point that stands for `area_m2`, when one point is to be kept for each `area_per_point`.
SPLATBUS_PORTABLE std::uint64_t share_of(float area_m2, float area_per_point) {
  const float share = area_m2 / area_per_point;
  return share < 1 ? static_cast<std::uint64_t>(share * 4294967296.0F) : std::uint64_t{1} << kShareBits;
}

/// What the area per point would be if the `certain` largest points were kept for sure: the others, `rest_m2` in all,
/// share what is left of the budget.
SPLATBUS_PORTABLE double area_per_point(double rest_m2, std::size_t certain, std::size_t budget) {
  return rest_m2 / static_cast<double>(budget - certain);
}

}  // namespace splatbus::capture_bridge
