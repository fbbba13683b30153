#include "expander/cell.h"

namespace splatbus::expander {

namespace {

std::optional<CellId> named(CellId cell) {
  return cell == kNoCell ? std::nullopt : std::optional(cell);
}

}  // namespace

std::optional<CellId> cell_at(const glm::vec3& point, const Frame& frame, float cell_size_m) {
  const glm::vec3 scaled = glm::floor(point / cell_size_m + 0.5F);
  return named(pack_floored(scaled.x, scaled.y, scaled.z, cell_prefix(frame.local, frame.object_id)));
}

std::optional<CellId> neighbour(CellId cell, int dx, int dy, int dz) {
  return named(neighbour_cell(cell, dx, dy, dz));
}

glm::vec3 cell_centre(CellId cell, float cell_size_m) {
  const CellCoordinates at = unpack_cell(cell);
  return glm::vec3(at.x, at.y, at.z) * cell_size_m;
}

}  // namespace splatbus::expander
