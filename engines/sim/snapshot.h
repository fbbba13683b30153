#pragma once

#include <string>

#include "sim/renderer.h"

namespace splatbus::sim {

/// "EYE_X,EYE_Y,EYE_Z,TARGET_X,TARGET_Y,TARGET_Z[,FOV_DEG]" as a camera. Throws std::runtime_error that says what is
/// wrong.
[[nodiscard]] splatbus_camera parse_pose(const std::string& text, std::uint32_t width, std::uint32_t height);

/// Renders one buffer ("color", "albedo", "normal", "position", "depth", "id", "light_depth") as a PNG; what is no
/// colour is mapped to one. Throws std::runtime_error.
void write_snapshot(Renderer& renderer, const splatbus_camera& camera, const std::string& buffer,
                    const std::string& path);

}  // namespace splatbus::sim
