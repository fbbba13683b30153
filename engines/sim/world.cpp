#include "sim/world.h"

#include "sim/world_builder.h"
#include "sim/world_house.h"
#include "sim/world_life.h"
#include "sim/world_parts.h"
#include "sim/world_plan.h"

namespace splatbus::sim {

Scene make_world(std::uint32_t seed, bool dynamics) {
  const WorldPlan plan = plan_world(seed);
  WorldBuilder builder(plan);
  add_ground(builder);
  for (const HousePlan& house : plan.houses) add_house(builder, house);
  add_gardens(builder);
  add_street_things(builder);
  add_park(builder);
  add_trees(builder);
  Scene scene = builder.finish();
  if (dynamics) add_world_life(scene, plan);
  return scene;
}

}  // namespace splatbus::sim
