#pragma once

#include <cstddef>
#include <vector>

#include "capture-bridge/input_view.h"
#include "capture-bridge/pixel_view.h"

namespace splatbus::capture_bridge {

/// A round's views for the per-pixel functions. Movable; the pictures stay the views'.
struct PixelViews {
  std::vector<PixelView> views;
  std::vector<MovedObject> moved;  ///< of all views; each view points into it
  std::size_t pixels = 0;          ///< of all views

  [[nodiscard]] bool movement() const { return !moved.empty(); }
};

/// `round_objects` are the transforms of the round's frame. Throws std::runtime_error when there are more than 255
/// views or 2^30 pixels.
[[nodiscard]] PixelViews pixel_views(Views views, const ObjectTransforms& round_objects);

}  // namespace splatbus::capture_bridge
