#pragma once

#include <optional>
#include <string>

#include "bus/context.h"
#include "gaussians/camera.h"
#include "viewer/camera_path.h"

namespace splatbus::viewer {

/// Where a viewer is, which one that another one takes the place of leaves to that.
struct Place {
  std::string path;   ///< name_of() it
  double path_s = 0;  ///< time of it
  Camera camera;
};

/// What a time of the path is of: other paths, and those that begin elsewhere, have another name.
[[nodiscard]] std::string name_of(const PathOptions& path);

/// Of the viewer before; nothing, and a warning, where what it left cannot be used.
[[nodiscard]] std::optional<Place> take_place(bus::Context& bus);
void leave_place(bus::Context& bus, const Place& place);

}  // namespace splatbus::viewer
