#pragma once

#include <string>

#include "sim/scene.h"

namespace splatbus::sim {

/// Loads a glTF 2.0 file (.glb or .gltf): every node with a mesh is an object, placed by the nodes above it; base
/// colour factor and texture, alpha mask, double-sidedness; normals from the file or from the triangles. What is
/// unsupported (skins, animation, lights) is ignored. The scene is left where it is, in metres.
///
/// Throws std::runtime_error that names the file, the part of it and what is wrong with it. Sizes are bounded before
/// anything is allocated for them.
[[nodiscard]] Scene load_gltf(const std::string& path);

}  // namespace splatbus::sim
