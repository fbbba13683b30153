#pragma once

#include <glm/glm.hpp>
#include <vector>

#include "capture-bridge/free_space.h"
#include "capture-bridge/rig.h"
#include "capture-bridge/viewers.h"

namespace splatbus::capture_bridge {

/// Where a dome of input cameras stands.
struct DomePlace {
  glm::vec3 centre{0};
  float heading_radians = 0;
};

/// Where the dome is to stand for a viewer (null: none is known yet), whose free space is known or not (null).
[[nodiscard]] DomePlace dome_place(const DomePlacement& options, const Viewer* viewer, const FreeSpace* free,
                                   float heading_before);

/// The dome's cameras there, each where it can see: what would stand in a wall or behind one stands higher on the dome,
/// or is drawn towards the place of the free space; one that comes nearer to the centre than half the radius by that
/// looks back along its way.
[[nodiscard]] std::vector<Camera> free_dome(const DomeOptions& options, const DomePlace& place, const FreeSpace* free,
                                            float clearance_m);

/// The picture of an input camera where the viewer will be, as far as he can get: all that his own will show, and a
/// margin about it. The dome looks at what is before him, and at no ceiling and through no door.
[[nodiscard]] Camera eye_camera(const DomeOptions& options, const DomePlacement& placement, const Viewer& viewer,
                                const FreeSpace* free, float clearance_m);

}  // namespace splatbus::capture_bridge
