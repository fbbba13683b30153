#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "sim/scene.h"

namespace splatbus::sim {

/// What a file may come to in all, so that a small one cannot fill the memory.
struct GltfLimits {
  std::uintmax_t file_bytes = std::uintmax_t{1} << 30;      ///< the file and those that it names
  std::size_t image_bytes = std::size_t{1} << 30;           ///< decoded, four a pixel
  std::size_t vertices = 20'000'000, indices = 60'000'000;  ///< of every mesh, once for each node that has it
};

/// How a file's coordinates are metres with y up.
struct GltfFrame {
  float metres_a_unit = 1;
  std::string up = "y";  ///< the file's axis that points up: x, -x, y, -y, z or -z
};

/// Loads a glTF 2.0 file (.glb or .gltf): every node with a mesh is an object, placed by the nodes above it; base
/// colour factor and texture, alpha mask, double-sidedness; normals from the file or from the triangles. What is
/// unsupported (skins, animation, lights) is ignored. The scene is left where it is, in
/// metres once `frame` is applied about the origin.
///
/// Throws std::runtime_error that names the file, the part of it and what is wrong with it. Sizes, and their
/// sums, are bounded before anything is allocated for them.
[[nodiscard]] Scene load_gltf(const std::string& path, const GltfLimits& limits = {}, const GltfFrame& frame = {});

}  // namespace splatbus::sim
