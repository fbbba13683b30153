#pragma once

#include "sim/gltf_file.h"
#include "sim/mesh.h"

namespace splatbus::sim {

/// What all meshes may come to.
struct MeshBudget {
  Budget vertices, indices;

  /// Takes what read_primitive() is about to make, or more.
  void take(const tinygltf::Model& model, const tinygltf::Primitive& primitive, int position, bool flat);
};

/// The triangles of a primitive of mode triangles, strip or fan. Where the file has no normals every triangle gets
/// vertices of its own. Throws std::runtime_error that says what is wrong.
[[nodiscard]] Mesh read_primitive(const tinygltf::Model& model, const tinygltf::Primitive& primitive,
                                  MeshBudget& budget);

}  // namespace splatbus::sim
