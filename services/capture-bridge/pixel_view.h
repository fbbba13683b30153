#pragma once

#include <cstdint>

#include "math/portable.h"

namespace splatbus::capture_bridge {

using math::clamped, math::cross, math::dot, math::is_finite, math::larger, math::length, math::load3, math::load4,
    math::Mat3, math::normalized, math::smaller, math::transformed, math::transposed, math::Vec3, math::Vec4;

/// An object that stands elsewhere in the round's frame than in a view's.
struct MovedObject {
  std::uint32_t id = 0;
  math::Rigid round_from_view, view_from_round;
};

/// An input view as the per-pixel functions read it. The pointers are of one kind of memory, and owned elsewhere.
struct PixelView {
  std::uint32_t width = 0, height = 0;
  std::uint32_t first_pixel = 0;  ///< pixels of the views before this one
  float fx = 0, fy = 0, cx = 0, cy = 0;
  float near_m = 0, far_m = 0;
  Vec3 centre;             ///< the camera's, in the world
  Mat3 world_from_camera;  ///< rotation alone
  Mat3 camera_from_world;  ///< rotation alone
  Vec3 background;
  const float* position = nullptr;  ///< [h, w, 4], as in InputView
  const float* normal = nullptr;    ///< [h, w, 4]
  const std::uint8_t* color = nullptr;
  const std::uint8_t* albedo = nullptr;
  const MovedObject* moved = nullptr;  ///< by ascending id
  std::uint32_t moved_count = 0;
};

/// Null unless the object has moved.
SPLATBUS_PORTABLE const MovedObject* find_moved(const PixelView& view, std::uint32_t object_id) {
  std::uint32_t low = 0;
  std::uint32_t high = view.moved_count;
  while (low < high) {
    const std::uint32_t middle = (low + high) / 2;
    view.moved[middle].id < object_id ? low = middle + 1 : high = middle;
  }
  return low < view.moved_count && view.moved[low].id == object_id ? view.moved + low : nullptr;
}

}  // namespace splatbus::capture_bridge
