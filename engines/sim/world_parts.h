#pragma once

#include "sim/world_builder.h"

namespace splatbus::sim {

// What stands out of doors. Nothing of it is in the way of world_walk().

/// Ground, carriageways, kerbs, pavements and markings.
void add_ground(WorldBuilder& builder);
/// On the rim, in gardens and in the park.
void add_trees(WorldBuilder& builder);
/// Fences and hedges of gardens, stepping stones to doors.
void add_gardens(WorldBuilder& builder);
/// Lamp posts, bins, letter boxes, signs, benches and parked cars.
void add_street_things(WorldBuilder& builder);
/// Paths, a fountain, a pavilion, benches and a playground.
void add_park(WorldBuilder& builder);

/// One tree, its foot at the origin.
void add_leafy_tree(const Site& site, float height_m, Draw& draw);
void add_conifer(const Site& site, float height_m, Draw& draw);
void add_bush(const Site& site, float radius_m, Draw& draw);
void add_bench(const Site& site, Draw& draw);

/// A ball with bumps, for foliage and stones.
[[nodiscard]] Mesh bumpy_ball(const glm::vec3& radius, float bumps, int segments, Draw& draw);

}  // namespace splatbus::sim
