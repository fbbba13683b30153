#pragma once

#include <gtest/gtest.h>

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

inline void expect_same(const Pictures& a, const Pictures& b) {
  EXPECT_EQ(a.color, b.color);
  EXPECT_EQ(a.albedo, b.albedo);
  EXPECT_EQ(a.world_position, b.world_position);
  EXPECT_EQ(a.normal, b.normal);
  EXPECT_EQ(a.depth, b.depth);
  EXPECT_EQ(a.object_id, b.object_id);
  EXPECT_EQ(a.light_depth, b.light_depth);
}

}  // namespace splatbus::sim
