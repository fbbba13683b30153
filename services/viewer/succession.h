#pragma once

#include <optional>

#include "bus/context.h"
#include "gaussians/camera.h"

namespace splatbus::viewer {

/// Where a viewer is, which one that is told to end leaves to the next of its name.
struct Place {
  double path_s = 0;  ///< time of its path
  Camera camera;
};

/// Of the viewer before; nothing, and a warning, where what it left cannot be used.
[[nodiscard]] std::optional<Place> take_place(bus::Context& bus);
void leave_place(bus::Context& bus, const Place& place);

}  // namespace splatbus::viewer
