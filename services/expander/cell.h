#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <optional>

#include "expander/cell_packing.h"

namespace splatbus::expander {

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
