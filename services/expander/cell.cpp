#include "expander/cell.h"

#include <cmath>

namespace splatbus::expander {

namespace {

constexpr unsigned kWorldBits = 21;
constexpr unsigned kObjectBits = 15;
constexpr std::uint32_t kObjectIdMask = (1U << 18U) - 1;

struct Coordinates {
  std::int64_t x, y, z;
};

unsigned bits_of(CellId cell) {
  return (cell & kObjectCell) != 0 ? kObjectBits : kWorldBits;
}

std::optional<CellId> pack(const Coordinates& at, unsigned bits, CellId prefix) {
  const std::int64_t half = std::int64_t{1} << (bits - 1);
  for (const std::int64_t v : {at.x, at.y, at.z}) {
    if (v < -half || v >= half) return std::nullopt;
  }
  return prefix | static_cast<CellId>(at.x + half) << (2 * bits) | static_cast<CellId>(at.y + half) << bits |
         static_cast<CellId>(at.z + half);
}

Coordinates unpack(CellId cell) {
  const unsigned bits = bits_of(cell);
  const CellId mask = (CellId{1} << bits) - 1;
  const std::int64_t half = std::int64_t{1} << (bits - 1);
  return {static_cast<std::int64_t>(cell >> (2 * bits) & mask) - half,
          static_cast<std::int64_t>(cell >> bits & mask) - half, static_cast<std::int64_t>(cell & mask) - half};
}

CellId prefix_of(CellId cell) {
  return (cell & kObjectCell) != 0 ? cell >> (3 * kObjectBits) << (3 * kObjectBits) : 0;
}

}  // namespace

std::optional<CellId> cell_at(const glm::vec3& point, const Frame& frame, float cell_size_m) {
  const glm::vec3 scaled = glm::floor(point / cell_size_m + 0.5F);
  constexpr float kLargest = 1 << kWorldBits;
  for (int axis = 0; axis < 3; ++axis) {
    if (!(std::abs(scaled[axis]) < kLargest)) return std::nullopt;
  }
  const Coordinates at{static_cast<std::int64_t>(scaled.x), static_cast<std::int64_t>(scaled.y),
                       static_cast<std::int64_t>(scaled.z)};
  if (!frame.local) return pack(at, kWorldBits, 0);
  return pack(at, kObjectBits, kObjectCell | static_cast<CellId>(frame.object_id & kObjectIdMask) << (3 * kObjectBits));
}

std::optional<CellId> neighbour(CellId cell, int dx, int dy, int dz) {
  const Coordinates at = unpack(cell);
  return pack({at.x + dx, at.y + dy, at.z + dz}, bits_of(cell), prefix_of(cell));
}

glm::vec3 cell_centre(CellId cell, float cell_size_m) {
  const Coordinates at = unpack(cell);
  return glm::vec3(at.x, at.y, at.z) * cell_size_m;
}

}  // namespace splatbus::expander
