#pragma once

#include <cstdint>
#include <map>
#include <span>

#include "sdk/splatbus_engine.h"
#include "sim/mesh.h"

namespace splatbus::sim {

/// Says by a number when a light's depth maps would show anything else: when the light has moved, turned or returned,
/// or something that they show has moved, come or gone within its reach. How brightly it shines does not matter.
class DepthVersions {
 public:
  /// The scene of the next instant. `moved` bounds in the world, before and after, what depth maps show and what is no
  /// longer where it was. Writes the versions, from 1, into `light`, and `sources`, which are the light's.
  void update(splatbus_light& light, std::span<splatbus_light_source> sources, std::span<const Bounds> moved);

 private:
  struct Known {
    splatbus_light_source source;
    std::uint64_t version = 0;
    bool exists = false;
  };
  std::map<std::uint32_t, Known> sources_;  ///< by id; those that have gone too, so that no version comes again
  float sun_direction_[3] = {0, 0, 0};
  std::uint64_t sun_version_ = 0;
};

}  // namespace splatbus::sim
