#pragma once

#include <span>

#include "sim/world_builder.h"

namespace splatbus::sim {

/// A thing that stands in a room with its back to a wall: about the origin of its footprint, on y = 0, its front
/// towards +z.
struct Furniture {
  glm::vec2 footprint;  ///< x, z
  void (*add)(const Site& site, const glm::vec2& footprint, Draw& draw);
};

/// Of a living room, a kitchen or a bedroom, the largest first; footprints by the draw.
enum class RoomUse { Living, Kitchen, Bedroom };
[[nodiscard]] std::vector<Furniture> furniture_of(RoomUse use, Draw& draw);

void add_table(const Site& site, const glm::vec2& footprint, Draw& draw);
void add_chair(const Site& site, const glm::vec2& footprint, Draw& draw);
/// Boxes, cups, a vase or books on a level top.
void add_things(const Site& top, const glm::vec2& area, int count, Draw& draw);
void add_plant(const Site& site, const glm::vec2& footprint, Draw& draw);
/// A framed picture of that size in the plane z = 0, facing +z, about the origin.
void add_picture(const Site& site, const glm::vec2& size, Draw& draw);

/// Some colour for things.
[[nodiscard]] glm::vec3 any_tint(Draw& draw);

}  // namespace splatbus::sim
