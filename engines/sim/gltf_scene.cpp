#include "sim/gltf_scene.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <stb_image.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <glm/gtc/type_ptr.hpp>
#include <memory>
#include <set>
#include <stdexcept>
#include <vector>

#include "sim/gltf_accessor.h"

namespace splatbus::sim {
namespace {

constexpr int kGreatestImageSide = 8192;
constexpr int kDeepestNode = 256;

/// What is left of a limit.
class Budget {
 public:
  Budget(std::uintmax_t limit, const char* what) : limit_(limit), left_(limit), what_(what) {}

  /// Throws when it is not there.
  void take(std::uintmax_t amount) {
    if (amount > left_) throw std::runtime_error(fmt::format("more than {} {} in all", limit_, what_));
    left_ -= amount;
  }

 private:
  std::uintmax_t limit_, left_;
  const char* what_;
};

/// tinygltf's image callback: four channels of eight bits, of a size checked before it is decoded; `user` is
/// the Budget of all images' bytes.
bool decode_image(tinygltf::Image* image, const int index, std::string* error, std::string* /*warning*/, int /*width*/,
                  int /*height*/, const unsigned char* bytes, int size, void* user) {
  int width = 0;
  int height = 0;
  int channels = 0;
  const auto refuse = [&](const std::string& what) {
    if (error != nullptr) *error += fmt::format("image {}: {}", index, what);
    return false;
  };
  if (stbi_info_from_memory(bytes, size, &width, &height, &channels) == 0) return refuse("it is no PNG or JPEG");
  if (width < 1 || height < 1 || width > kGreatestImageSide || height > kGreatestImageSide) {
    return refuse(fmt::format("{} x {} pixels, where a side has at most {}", width, height, kGreatestImageSide));
  }
  const std::size_t decoded_bytes = std::size_t{4} * static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  try {
    static_cast<Budget*>(user)->take(decoded_bytes);
  } catch (const std::runtime_error& over) {
    return refuse(over.what());
  }
  const std::unique_ptr<stbi_uc, void (*)(void*)> pixels(
      stbi_load_from_memory(bytes, size, &width, &height, &channels, 4), stbi_image_free);
  if (!pixels) return refuse(fmt::format("it cannot be decoded ({})", stbi_failure_reason()));
  image->width = width;
  image->height = height;
  image->component = 4;
  image->bits = 8;
  image->pixel_type = TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE;
  image->image.assign(pixels.get(), pixels.get() + decoded_bytes);
  return true;
}

/// tinygltf's file callback; `user` is the Budget of all files' bytes.
bool read_bounded_file(std::vector<unsigned char>* out, std::string* error, const std::string& path, void* user) {
  std::error_code code;
  const std::uintmax_t size = std::filesystem::file_size(path, code);
  try {
    if (code) throw std::runtime_error(code.message());
    static_cast<Budget*>(user)->take(size);
  } catch (const std::runtime_error& failure) {
    if (error != nullptr) *error += fmt::format("{}: {}", path, failure.what());
    return false;
  }
  return tinygltf::ReadWholeFile(out, error, path, user);
}

tinygltf::Model parse(const std::string& path, const GltfLimits& limits) {
  Budget file_bytes(limits.file_bytes, "bytes of files");
  Budget image_bytes(limits.image_bytes, "bytes of images");
  tinygltf::TinyGLTF loader;
  loader.SetImageLoader(decode_image, &image_bytes);
  loader.SetFsCallbacks({.FileExists = tinygltf::FileExists,
                         .ExpandFilePath = tinygltf::ExpandFilePath,
                         .ReadWholeFile = read_bounded_file,
                         .WriteWholeFile = tinygltf::WriteWholeFile,
                         .user_data = &file_bytes});
  tinygltf::Model model;
  std::string error;
  std::string warning;
  const bool binary = std::filesystem::path(path).extension() != ".gltf";
  const bool loaded = binary ? loader.LoadBinaryFromFile(&model, &error, &warning, path)
                             : loader.LoadASCIIFromFile(&model, &error, &warning, path);
  if (!warning.empty()) spdlog::warn("{}: {}", path, warning);
  if (!loaded) throw std::runtime_error(error.empty() ? "it is no glTF file" : error);
  const std::set<std::string> supported{"KHR_materials_unlit", "KHR_materials_specular", "KHR_materials_ior"};
  for (const std::string& extension : model.extensionsRequired) {
    if (!supported.contains(extension))
      throw std::runtime_error(fmt::format("it requires {}, which is not supported", extension));
  }
  return model;
}

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
    throw std::runtime_error(fmt::format("accessor {}: {} rows, where {} are the most", accessor, rows, kMostRows));
  return rows;
}

/// What all meshes may come to.
struct MeshBudget {
  Budget vertices, indices;

  /// Takes what read_primitive() is about to make, or more.
  void take(const tinygltf::Model& model, const tinygltf::Primitive& primitive, int position, bool flat) {
    const std::size_t rows = checked_rows(model, position);
    const std::size_t sequence = primitive.indices < 0 ? rows : checked_rows(model, primitive.indices);
    const std::size_t corners = primitive.mode == TINYGLTF_MODE_TRIANGLES ? sequence : 3 * sequence;
    indices.take(corners);
    vertices.take(std::max({rows, flat ? corners : 0, std::size_t{1}}));
  }
};

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

class SceneReader {
 public:
  SceneReader(tinygltf::Model model, const GltfLimits& limits)
      : model_(std::move(model)), budget_{{limits.vertices, "vertices"}, {limits.indices, "indices"}} {}

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
  std::vector<int> root_nodes() const {
    if (!model_.scenes.empty()) return item(model_.scenes, std::max(model_.defaultScene, 0), "scene").nodes;
    std::set<int> children;
    for (const tinygltf::Node& node : model_.nodes) children.insert(node.children.begin(), node.children.end());
    std::vector<int> roots;
    for (int i = 0; i < static_cast<int>(model_.nodes.size()); ++i) {
      if (!children.contains(i)) roots.push_back(i);
    }
    return roots;
  }

  void visit(int index, const glm::mat4& world_from_parent, int depth) {
    const tinygltf::Node& node = item(model_.nodes, index, "node");
    if (depth > kDeepestNode)
      throw std::runtime_error(fmt::format("node {}: more than {} levels", index, kDeepestNode));
    if (!visited_.insert(index).second)
      throw std::runtime_error(fmt::format("node {}: it is in the hierarchy twice", index));
    const glm::mat4 world_from_node = within(fmt::format("node {} ('{}')", index, node.name), [&] {
      glm::mat4 placed = world_from_parent * local_transform(node);
      if (node.mesh >= 0) add_object(index, node, placed);
      return placed;
    });
    for (const int child : node.children) visit(child, world_from_node, depth + 1);
  }

  void add_object(int index, const tinygltf::Node& node, const glm::mat4& world_from_node) {
    const float determinant = glm::determinant(glm::mat3(world_from_node));
    if (!std::isfinite(determinant) || std::abs(determinant) < 1e-18F)
      throw std::runtime_error("its transform flattens it");
    Object object;
    object.id = static_cast<std::uint32_t>(scene_.objects.size() + 1);
    object.name = node.name.empty() ? fmt::format("node {}", index) : node.name;
    object.world_from_object = world_from_node;
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
  Scene scene_;
  std::set<int> visited_;
  MeshBudget budget_;
};

}  // namespace

Scene load_gltf(const std::string& path, const GltfLimits& limits) {
  return within(path, [&] { return SceneReader(parse(path, limits), limits).read(); });
}

}  // namespace splatbus::sim
