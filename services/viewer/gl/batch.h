#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "viewer/gl/rows.h"

namespace splatbus::viewer::gl {

/// A sphere about most of what there is but for the far field, metres in the world.
struct Bounds {
  glm::vec3 centre{0};
  float radius_m = 1;
};

/// What has changed of the rows, and what they are shown under. Batches are applied in their order.
struct Batch {
  bool whole = false;  ///< all rows before are gone
  RowUpdate update;
  ColorUpdate colors;
  /// When that was which the colors show, and the newest scene, by the engine's clock; 0: nobody knows.
  std::int64_t colors_ns = 0, scene_ns = 0;
  std::vector<std::uint32_t> object_ids;  ///< by the index that records have; the first is the world
  bool display_space = false;             ///< of the colors
  std::optional<Bounds> bounds;
};

using SharedBatch = std::shared_ptr<const Batch>;

}  // namespace splatbus::viewer::gl
