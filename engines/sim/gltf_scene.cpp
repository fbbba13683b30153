#include "sim/gltf_scene.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <glm/gtc/type_ptr.hpp>
#include <set>
#include <stdexcept>
#include <vector>

#include "sim/gltf_accessor.h"
#include "sim/gltf_file.h"
#include "sim/gltf_mesh.h"

namespace splatbus::sim {
namespace {

constexpr int kDeepestNode = 256;

Material read_material(const tinygltf::Model& model, const tinygltf::Material& source) {
  Material material;
  const std::vector<double>& factor = source.pbrMetallicRoughness.baseColorFactor;
  for (int c = 0; c < 3 && static_cast<std::size_t>(c) < factor.size(); ++c) {
    const auto value = static_cast<float>(factor[static_cast<std::size_t>(c)]);
    if (!(value >= 0 && value <= 1)) throw std::runtime_error(fmt::format("a base colour factor of {}", value));
    material.base_color[c] = value;
  }
  material.double_sided = source.doubleSided;
  if (source.alphaMode == "MASK") material.alpha_cutoff = static_cast<float>(source.alphaCutoff);
  if (!std::isfinite(material.alpha_cutoff)) throw std::runtime_error("its alpha cutoff is not finite");
  const int texture = source.pbrMetallicRoughness.baseColorTexture.index;
  if (texture < 0) return material;
  const tinygltf::Texture& from = item(model.textures, texture, "texture");
  static_cast<void>(item(model.images, from.source, "image"));
  material.image = from.source;
  if (from.sampler >= 0) {
    material.repeat = item(model.samplers, from.sampler, "sampler").wrapS != TINYGLTF_TEXTURE_WRAP_CLAMP_TO_EDGE;
  }
  return material;
}

glm::mat4 local_transform(const tinygltf::Node& node) {
  const auto finite = [](const std::vector<double>& values) {
    return std::ranges::all_of(values, [](double value) { return std::isfinite(value) && std::abs(value) < 1e6; });
  };
  if (!finite(node.matrix) || !finite(node.translation) || !finite(node.rotation) || !finite(node.scale)) {
    throw std::runtime_error("its transform is not finite");
  }
  if (node.matrix.size() == 16) return glm::mat4(glm::make_mat4(node.matrix.data()));
  Pose pose;
  if (node.translation.size() == 3) pose.translation = glm::vec3(glm::make_vec3(node.translation.data()));
  if (node.rotation.size() == 4) {
    const glm::dquat q(node.rotation[3], node.rotation[0], node.rotation[1], node.rotation[2]);
    if (glm::length(q) < 1e-6) throw std::runtime_error("its rotation is zero");
    pose.rotation = glm::quat(glm::normalize(q));
  }
  glm::mat4 result = matrix(pose);
  for (int c = 0; c < 3 && node.scale.size() == 3; ++c)
    result[c] *= static_cast<float>(node.scale[static_cast<std::size_t>(c)]);
  return result;
}

glm::mat4 world_from_file(const GltfFrame& frame) {
  if (!(frame.metres_a_unit > 0) || !std::isfinite(frame.metres_a_unit))
    throw std::runtime_error(fmt::format("{} metres a unit", frame.metres_a_unit));
  const bool down = frame.up.starts_with('-');
  const std::string axis = frame.up.substr(down ? 1 : 0);
  if (axis != "x" && axis != "y" && axis != "z")
    throw std::runtime_error(fmt::format("there is no axis '{}'", frame.up));
  // The shortest turn that takes the axis to +y.
  const glm::vec3 about = axis == "x" ? glm::vec3(0, 0, 1) : glm::vec3(1, 0, 0);
  const float quarters = axis == "y" ? (down ? 2.0F : 0.0F) : axis == "x" ? (down ? -1.0F : 1.0F) : down ? 1.0F : -1.0F;
  Pose pose;
  pose.rotation = glm::angleAxis(quarters * glm::half_pi<float>(), about);
  pose.scale = frame.metres_a_unit;
  return matrix(pose);
}

class SceneReader {
 public:
  SceneReader(tinygltf::Model model, const GltfLimits& limits, const GltfFrame& frame)
      : model_(std::move(model)),
        world_from_file_(world_from_file(frame)),
        budget_{{limits.vertices, "vertices"}, {limits.indices, "indices"}} {}

  Scene read() {
    for (tinygltf::Image& image : model_.images) {
      if (image.image.empty()) throw std::runtime_error(fmt::format("image '{}' is empty", image.name));
      scene_.images.push_back({.width = static_cast<std::uint32_t>(image.width),
                               .height = static_cast<std::uint32_t>(image.height),
                               .rgba = std::move(image.image)});
    }
    scene_.materials.emplace_back();  // for primitives without one
    for (std::size_t i = 0; i < model_.materials.size(); ++i) {
      scene_.materials.push_back(within(fmt::format("material {} ('{}')", i, model_.materials[i].name),
                                        [&] { return read_material(model_, model_.materials[i]); }));
    }
    for (const int root : root_nodes()) visit(root, glm::mat4(1), 0);
    if (scene_.objects.empty())
      throw std::runtime_error("there is nothing to draw in it: no node has a mesh of triangles");
    return std::move(scene_);
  }

 private:
  [[nodiscard]] std::vector<int> root_nodes() const {
    if (!model_.scenes.empty()) return item(model_.scenes, std::max(model_.defaultScene, 0), "scene").nodes;
    std::set<int> children;
    for (const tinygltf::Node& node : model_.nodes) children.insert(node.children.begin(), node.children.end());
    std::vector<int> roots;
    for (int i = 0; i < static_cast<int>(model_.nodes.size()); ++i) {
      if (!children.contains(i)) roots.push_back(i);
    }
    return roots;
  }

  void visit(int index, const glm::mat4& file_from_parent, int depth) {
    const tinygltf::Node& node = item(model_.nodes, index, "node");
    if (depth > kDeepestNode)
      throw std::runtime_error(fmt::format("node {}: more than {} levels", index, kDeepestNode));
    if (!visited_.insert(index).second)
      throw std::runtime_error(fmt::format("node {}: it is in the hierarchy twice", index));
    const glm::mat4 file_from_node = within(fmt::format("node {} ('{}')", index, node.name), [&] {
      glm::mat4 placed = file_from_parent * local_transform(node);
      if (node.mesh >= 0) add_object(index, node, placed);
      return placed;
    });
    for (const int child : node.children) visit(child, file_from_node, depth + 1);
  }

  void add_object(int index, const tinygltf::Node& node, const glm::mat4& file_from_node) {
    const float determinant = glm::determinant(glm::mat3(file_from_node));
    if (!std::isfinite(determinant) || std::abs(determinant) < 1e-18F)
      throw std::runtime_error("its transform flattens it");
    Object object;
    object.id = static_cast<std::uint32_t>(scene_.objects.size() + 1);
    object.name = node.name.empty() ? fmt::format("node {}", index) : node.name;
    object.world_from_object = world_from_file_ * file_from_node;
    const tinygltf::Mesh& mesh = item(model_.meshes, node.mesh, "mesh");
    for (std::size_t i = 0; i < mesh.primitives.size(); ++i) {
      const tinygltf::Primitive& primitive = mesh.primitives[i];
      if (primitive.mode != TINYGLTF_MODE_TRIANGLES && primitive.mode != TINYGLTF_MODE_TRIANGLE_STRIP &&
          primitive.mode != TINYGLTF_MODE_TRIANGLE_FAN) {
        continue;
      }
      Part part;
      part.mesh = within(fmt::format("mesh {} ('{}'), primitive {}", node.mesh, mesh.name, i),
                         [&] { return read_primitive(model_, primitive, budget_); });
      if (primitive.material >= static_cast<int>(model_.materials.size())) {
        throw std::runtime_error(fmt::format("there is no material {}", primitive.material));
      }
      part.material = std::max(primitive.material, -1) + 1;
      if (determinant < 0) {
        for (std::size_t k = 0; k + 2 < part.mesh.indices.size(); k += 3)
          std::swap(part.mesh.indices[k + 1], part.mesh.indices[k + 2]);
      }
      if (!part.mesh.indices.empty()) object.parts.push_back(std::move(part));
    }
    if (!object.parts.empty()) scene_.objects.push_back(std::move(object));
  }

  tinygltf::Model model_;
  glm::mat4 world_from_file_;
  Scene scene_;
  std::set<int> visited_;
  MeshBudget budget_;
};

}  // namespace

Scene load_gltf(const std::string& path, const GltfLimits& limits, const GltfFrame& frame) {
  return within(path, [&] { return SceneReader(read_gltf_file(path, limits), limits, frame).read(); });
}

}  // namespace splatbus::sim
