#include "sim/gpu_scene.h"

#include <algorithm>
#include <cstddef>
#include <glm/gtc/matrix_inverse.hpp>
#include <glm/gtc/matrix_transform.hpp>
#include <optional>
#include <utility>

#include "sim/shader_text.h"

namespace splatbus::sim {
namespace {

template <class T>
GlBuffer upload(const std::vector<T>& items, GLbitfield flags = 0) {
  GlBuffer buffer = make_buffer();
  const std::size_t bytes = std::max<std::size_t>(1, items.size()) * sizeof(T);
  glNamedBufferStorage(buffer.get(), static_cast<GLsizeiptr>(bytes), items.empty() ? nullptr : items.data(), flags);
  return buffer;
}

splatbus_object to_listed(std::uint32_t id, const Pose& pose, std::uint32_t flags) {
  const glm::quat& q = pose.rotation;
  const glm::vec3& t = pose.translation;
  return {.id = id, .world_from_object = {{q.w, q.x, q.y, q.z}, {t.x, t.y, t.z}}, .scale = pose.scale, .flags = flags};
}

}  // namespace

GpuScene::GpuScene(const Scene& scene, float anisotropy, bool cull)
    : cull_(cull),
      textures_(scene, anisotropy),
      box_program_(build_program(kBoxVertexShader, kBoxFragmentShader)),
      instance_program_(build_compute_program(kInstanceShader)) {
  add_meshes(scene);
  instance_data_.resize(parts_.size() + objects_.size());
  for (std::size_t i = 0; i < objects_.size(); ++i) place(i, scene.objects[i].world_from_object);
  instances_ = upload(instance_data_);
  add_attributes();
}

void GpuScene::add_meshes(const Scene& scene) {
  std::vector<Vertex> vertices;
  std::vector<std::uint32_t> indices, object_of_part;
  const auto add_mesh = [&](const Mesh& mesh) {
    const MeshRange range{.first_vertex = static_cast<std::int32_t>(vertices.size()),
                          .first_index = static_cast<std::uint32_t>(indices.size()),
                          .index_count = static_cast<std::uint32_t>(mesh.indices.size())};
    vertices.insert(vertices.end(), mesh.vertices.begin(), mesh.vertices.end());
    indices.insert(indices.end(), mesh.indices.begin(), mesh.indices.end());
    return range;
  };
  for (std::size_t i = 0; i < scene.objects.size(); ++i) {
    const Object& object = scene.objects[i];
    objects_.push_back({.id = object.id,
                        .casts_shadow = object.casts_shadow,
                        .in_light_depth = object.in_light_depth(),
                        .emissive = object.emissive,
                        .moving = object.motion || object.light_id != 0,
                        .enclosed = object.enclosed,
                        .exists = true,
                        .first_part = parts_.size(),
                        .part_count = object.parts.size(),
                        .box = {},
                        .world_from_object = glm::mat4(1),
                        .bounds_world = {}});
    for (const sim::Part& part : object.parts) {
      const auto index = static_cast<std::size_t>(part.material);
      const Material& material = scene.materials.at(index);
      parts_.push_back({.object = i,
                        .mesh = add_mesh(part.mesh),
                        .texture = textures_.place(index),
                        .base_color = material.base_color,
                        .alpha_cutoff = material.alpha_cutoff,
                        .double_sided = material.double_sided,
                        .bounds_local = bounds_of(part.mesh),
                        .bounds_world = {}});
      object_of_part.push_back(static_cast<std::uint32_t>(i));
      objects_.back().box.add(parts_.back().bounds_local);
    }
    constexpr float kMargin_m = 0.01F;  // surfaces on the box's own faces are behind it
    objects_.back().box.low -= kMargin_m;
    objects_.back().box.high += kMargin_m;
  }
  box_ = add_mesh(box(glm::vec3(1)));
  vertices_ = upload(vertices);
  indices_ = upload(indices);
  object_of_part_ = upload(object_of_part);
  seen_ = upload(std::vector<std::uint32_t>(objects_.size()), GL_DYNAMIC_STORAGE_BIT);
}

void GpuScene::add_attributes() {
  vertex_array_ = make_vertex_array();
  const GLuint array = vertex_array_.get();
  enum Binding : GLuint { kVertices, kInstances };
  glVertexArrayVertexBuffer(array, kVertices, vertices_.get(), 0, sizeof(Vertex));
  glVertexArrayVertexBuffer(array, kInstances, instances_.get(), 0, sizeof(InstanceData));
  glVertexArrayBindingDivisor(array, kInstances, 1);
  glVertexArrayElementBuffer(array, indices_.get());
  const auto enable = [&](GLuint location, Binding binding) {
    glEnableVertexArrayAttrib(array, location);
    glVertexArrayAttribBinding(array, location, binding);
  };
  const auto floats = [&](Binding binding, GLuint location, GLint size, std::size_t offset) {
    enable(location, binding);
    glVertexArrayAttribFormat(array, location, size, GL_FLOAT, GL_FALSE, static_cast<GLuint>(offset));
  };
  const auto numbers = [&](GLuint location, GLint size, std::size_t offset) {
    enable(location, kInstances);
    glVertexArrayAttribIFormat(array, location, size, GL_UNSIGNED_INT, static_cast<GLuint>(offset));
  };
  floats(kVertices, kPosition, 3, offsetof(Vertex, position));
  floats(kVertices, kNormal, 3, offsetof(Vertex, normal));
  floats(kVertices, kUv, 2, offsetof(Vertex, uv));
  enable(kTint, kVertices);
  glVertexArrayAttribFormat(array, kTint, 4, GL_UNSIGNED_BYTE, GL_TRUE, offsetof(Vertex, tint));
  for (GLuint column = 0; column < 4; ++column) {
    floats(kInstances, kWorldFromPart + column, 4,
           offsetof(InstanceData, world_from_part) + column * sizeof(glm::vec4));
  }
  for (GLuint column = 0; column < 3; ++column) {
    floats(kInstances, kNormalMatrix + column, 3, offsetof(InstanceData, normal_matrix) + column * sizeof(glm::vec3));
  }
  floats(kInstances, kBaseAndCutoff, 4, offsetof(InstanceData, base_color));
  numbers(kIdAndLayer, 2, offsetof(InstanceData, object_id));
  numbers(kObjectIndex, 1, offsetof(InstanceData, object));
}

void GpuScene::place(std::size_t object, const glm::mat4& world_from_object) {
  ObjectState& state = objects_[object];
  state.world_from_object = world_from_object;
  state.bounds_world = {};
  InstanceData instance{.world_from_part = world_from_object,
                        .normal_matrix = glm::inverseTranspose(glm::mat3(world_from_object)),
                        .base_color = {},
                        .alpha_cutoff = 0,
                        .object_id = state.id,
                        .layer = 0,
                        .object = static_cast<std::uint32_t>(object)};
  for (std::size_t i = state.first_part; i < state.first_part + state.part_count; ++i) {
    Part& part = parts_[i];
    part.bounds_world = transformed(part.bounds_local, world_from_object);
    state.bounds_world.add(part.bounds_world);
    instance.base_color = part.base_color;
    instance.alpha_cutoff = part.alpha_cutoff;
    instance.layer = part.texture.layer;
    instance_data_[i] = instance;
  }
  instance.world_from_part = glm::scale(glm::translate(world_from_object, (state.box.low + state.box.high) / 2.0F),
                                        state.box.high - state.box.low);
  instance_data_[parts_.size() + object] = instance;
}

/// By a copy on the GPU: NVIDIA's driver (580) does not draw with instance attributes that glNamedBufferSubData has
/// written to a small buffer.
void GpuScene::send_placed(const std::vector<std::size_t>& objects) {
  if (objects.empty()) return;
  std::vector<InstanceData> data;
  struct Copy {
    std::size_t from, to, count;
  };
  std::vector<Copy> copies;
  const auto add = [&](std::size_t first, std::size_t count) {
    copies.push_back({data.size(), first, count});
    const auto begin = instance_data_.begin() + static_cast<std::ptrdiff_t>(first);
    data.insert(data.end(), begin, begin + static_cast<std::ptrdiff_t>(count));
  };
  for (const std::size_t object : objects) {
    add(objects_[object].first_part, objects_[object].part_count);
    add(parts_.size() + object, 1);
  }
  const GlBuffer sent = upload(data);
  for (const Copy& copy : copies) {
    glCopyNamedBufferSubData(sent.get(), instances_.get(), static_cast<GLintptr>(copy.from * sizeof(InstanceData)),
                             static_cast<GLintptr>(copy.to * sizeof(InstanceData)),
                             static_cast<GLsizeiptr>(copy.count * sizeof(InstanceData)));
  }
}

ObjectChanges GpuScene::set_time(const Scene& scene, double time_s, std::span<const splatbus_light_source> sources) {
  ObjectChanges changes;
  std::vector<splatbus_object> listed;
  std::vector<std::size_t> placed;
  for (std::size_t i = 0; i < scene.objects.size(); ++i) {
    const Object& object = scene.objects[i];
    std::uint32_t flags = 0;
    if (object.emissive) flags |= SPLATBUS_OBJECT_EMISSIVE;
    if (!object.modelled) flags |= SPLATBUS_OBJECT_NOT_MODELLED;
    if (!object.motion && object.light_id == 0 && flags == 0) continue;
    ObjectState& state = objects_[i];
    const bool dark =
        object.light_id != 0 &&
        (!scene.lighting.lamps_shown || std::ranges::count(sources, object.light_id, &splatbus_light_source::id) == 0);
    // What rests keeps the frame that it has unlisted: the world's.
    std::optional<Pose> pose = dark ? std::nullopt : object.motion ? object.motion(time_s) : Pose{};
    const bool was = std::exchange(state.exists, pose.has_value());
    const Bounds before = state.bounds_world;
    bool moved = was != state.exists;
    if (pose) {
      listed.push_back(to_listed(object.id, *pose, flags));
      const glm::mat4 world_from_object = object.motion ? matrix(*pose) : object.world_from_object;
      if (world_from_object != state.world_from_object) {
        place(i, world_from_object);
        placed.push_back(i);
        moved = true;
      }
    }
    if (!moved) continue;
    changes.any = true;
    if (!state.in_light_depth) continue;
    if (was) changes.moved.push_back(before);
    if (state.exists) changes.moved.push_back(state.bounds_world);
  }
  send_placed(placed);
  listed_ = std::move(listed);
  return changes;
}

}  // namespace splatbus::sim
