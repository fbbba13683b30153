#include "sim/gltf_mesh.h"

#include <algorithm>
#include <array>
#include <glm/gtc/type_ptr.hpp>
#include <vector>

namespace splatbus::sim {
namespace {

/// Corners of the triangles, in order, as vertex indices.
std::vector<std::uint32_t> triangle_corners(const tinygltf::Model& model, const tinygltf::Primitive& primitive,
                                            std::size_t vertex_count) {
  std::vector<std::uint32_t> sequence;
  if (primitive.indices >= 0) {
    sequence = read_indices(model, primitive.indices, vertex_count);
  } else {
    sequence.resize(vertex_count);
    for (std::size_t i = 0; i < vertex_count; ++i) sequence[i] = static_cast<std::uint32_t>(i);
  }
  if (primitive.mode == TINYGLTF_MODE_TRIANGLES) {
    sequence.resize(sequence.size() / 3 * 3);
    return sequence;
  }
  std::vector<std::uint32_t> corners;
  for (std::size_t i = 2; i < sequence.size(); ++i) {
    const bool fan = primitive.mode == TINYGLTF_MODE_TRIANGLE_FAN;
    const bool odd = !fan && i % 2 == 1;
    corners.insert(corners.end(),
                   {fan ? sequence[0] : sequence[odd ? i - 1 : i - 2], sequence[odd ? i - 2 : i - 1], sequence[i]});
  }
  return corners;
}

/// Without normals in the file every triangle gets vertices of its own, with its own normal.
void make_flat(Mesh& mesh) {
  Mesh flat;
  for (std::size_t i = 0; i + 2 < mesh.indices.size(); i += 3) {
    std::array<Vertex, 3> corners{mesh.vertices[mesh.indices[i]], mesh.vertices[mesh.indices[i + 1]],
                                  mesh.vertices[mesh.indices[i + 2]]};
    const glm::vec3 face =
        glm::cross(corners[1].position - corners[0].position, corners[2].position - corners[0].position);
    if (glm::dot(face, face) <= 0) continue;
    for (Vertex& corner : corners) {
      corner.normal = glm::normalize(face);
      flat.indices.push_back(static_cast<std::uint32_t>(flat.vertices.size()));
      flat.vertices.push_back(corner);
    }
  }
  mesh = std::move(flat);
}

std::size_t checked_rows(const tinygltf::Model& model, int accessor) {
  const std::size_t rows = item(model.accessors, accessor, "accessor").count;
  if (rows > kMostRows)
    throw std::runtime_error(fmt::format("accessor {}: {} rows, at most {} are allowed", accessor, rows, kMostRows));
  return rows;
}

}  // namespace

void MeshBudget::take(const tinygltf::Model& model, const tinygltf::Primitive& primitive, int position, bool flat) {
  const std::size_t rows = checked_rows(model, position);
  const std::size_t sequence = primitive.indices < 0 ? rows : checked_rows(model, primitive.indices);
  const std::size_t corners = primitive.mode == TINYGLTF_MODE_TRIANGLES ? sequence : 3 * sequence;
  indices.take(corners);
  vertices.take(std::max({rows, flat ? corners : 0, std::size_t{1}}));
}

Mesh read_primitive(const tinygltf::Model& model, const tinygltf::Primitive& primitive, MeshBudget& budget) {
  const auto attribute = [&](const char* name) {
    const auto found = primitive.attributes.find(name);
    return found == primitive.attributes.end() ? -1 : found->second;
  };
  if (attribute("POSITION") < 0) throw std::runtime_error("it has no POSITION");
  budget.take(model, primitive, attribute("POSITION"), attribute("NORMAL") < 0);
  const std::vector<float> positions = read_floats(model, attribute("POSITION"), 3);
  const std::size_t count = positions.size() / 3;
  std::vector<float> normals;
  std::vector<float> uvs;
  if (attribute("NORMAL") >= 0) normals = read_floats(model, attribute("NORMAL"), 3);
  if (attribute("TEXCOORD_0") >= 0) uvs = read_floats(model, attribute("TEXCOORD_0"), 2);
  if ((!normals.empty() && normals.size() != 3 * count) || (!uvs.empty() && uvs.size() != 2 * count)) {
    throw std::runtime_error("NORMAL or TEXCOORD_0 has another number of rows than POSITION");
  }
  Mesh mesh;
  mesh.vertices.resize(count);
  for (std::size_t i = 0; i < count; ++i) {
    Vertex& vertex = mesh.vertices[i];
    vertex = {.position = glm::make_vec3(&positions[3 * i]), .normal = {0, 1, 0}, .uv = {0, 0}};
    if (!uvs.empty()) vertex.uv = glm::make_vec2(&uvs[2 * i]);
    if (normals.empty()) continue;
    const glm::vec3 normal = glm::make_vec3(&normals[3 * i]);
    if (glm::dot(normal, normal) > 1e-12F) vertex.normal = glm::normalize(normal);
  }
  mesh.indices = triangle_corners(model, primitive, count);
  if (normals.empty()) make_flat(mesh);
  return mesh;
}

}  // namespace splatbus::sim
