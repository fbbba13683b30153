#pragma once

#include <cstddef>
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

/// An input camera where the viewer will be, as far as he can get, with his gaze of then: all that his own picture will
/// show, and a margin about it. The dome looks at what is before him, and at no ceiling and through no door.
[[nodiscard]] Camera eye_camera(const DomeOptions& options, const DomePlacement& placement, const Viewer& viewer,
                                const FreeSpace* free, float clearance_m);

/// `count` cameras in the eye's place that look level about, over what the eye does not see, but for those in whose way
/// nothing stands at its height. Three or more leave no direction out: wherever the viewer turns is modelled before he
/// has turned.
[[nodiscard]] std::vector<Camera> cameras_about(const Camera& eye, const FreeSpace* free, std::size_t count);

}  // namespace splatbus::capture_bridge
