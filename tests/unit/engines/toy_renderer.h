#pragma once

#include <cmath>
#include <cstdint>

#include "render_scenes.h"
#include "sim/renderer.h"
#include "sim/toys.h"

namespace splatbus::sim {

inline constexpr std::uint32_t kAll = SPLATBUS_BUFFER_COLOR | SPLATBUS_BUFFER_WORLD_POSITION | SPLATBUS_BUFFER_NORMAL |
                                      SPLATBUS_BUFFER_ALBEDO | SPLATBUS_BUFFER_DEPTH | SPLATBUS_BUFFER_OBJECT_ID;

inline Renderer& toys() {
  static Renderer renderer(shared_context(), make_toys(1, true));
  return renderer;
}

inline splatbus_camera ring_camera(float angle, std::uint32_t size = 96) {
  return look_at({3.4F * std::cos(angle), 1.6F, 3.4F * std::sin(angle)}, {0, 0.25F, 0}, size, size, 60);
}

}  // namespace splatbus::sim
