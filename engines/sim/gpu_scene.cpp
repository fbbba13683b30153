#include "sim/gpu_scene.h"

#include <algorithm>
#include <bit>
#include <cstddef>
#include <glm/gtc/matrix_inverse.hpp>
#include <glm/gtc/type_ptr.hpp>
#include <optional>
#include <utility>

#include "sim/projection.h"

namespace splatbus::sim {
namespace {

GlTexture upload(const Image& image, bool repeat, float anisotropy) {
  GlTexture texture = make_texture(GL_TEXTURE_2D);
  const auto levels = static_cast<GLsizei>(std::bit_width(std::max(image.width, image.height)));
  const auto width = static_cast<GLsizei>(image.width);
  const auto height = static_cast<GLsizei>(image.height);
  glTextureStorage2D(texture.get(), levels, GL_SRGB8_ALPHA8, width, height);
  glTextureSubImage2D(texture.get(), 0, 0, 0, width, height, GL_RGBA, GL_UNSIGNED_BYTE, image.rgba.data());
  glGenerateTextureMipmap(texture.get());
  glTextureParameteri(texture.get(), GL_TEXTURE_MIN_FILTER, GL_LINEAR_MIPMAP_LINEAR);
  glTextureParameteri(texture.get(), GL_TEXTURE_MAG_FILTER, GL_LINEAR);
  for (const GLenum axis : {GL_TEXTURE_WRAP_S, GL_TEXTURE_WRAP_T}) {
    glTextureParameteri(texture.get(), axis, repeat ? GL_REPEAT : GL_CLAMP_TO_EDGE);
  }
  if (anisotropy > 1 && epoxy_has_gl_extension("GL_EXT_texture_filter_anisotropic")) {
    glTextureParameterf(texture.get(), GL_TEXTURE_MAX_ANISOTROPY_EXT, anisotropy);
  }
  return texture;
}

splatbus_object to_listed(std::uint32_t id, const Pose& pose, std::uint32_t flags) {
  const glm::quat& q = pose.rotation;
  const glm::vec3& t = pose.translation;
  return {.id = id, .world_from_object = {{q.w, q.x, q.y, q.z}, {t.x, t.y, t.z}}, .scale = pose.scale, .flags = flags};
}

}  // namespace

GpuScene::GpuScene(const Scene& scene, float anisotropy, bool cull) : cull_(cull) {
  upload_textures(scene, anisotropy);

  std::vector<Vertex> vertices;
  std::vector<std::uint32_t> indices;
  for (std::size_t i = 0; i < scene.objects.size(); ++i) {
    const Object& object = scene.objects[i];
    objects_.push_back({.id = object.id,
                        .casts_shadow = object.casts_shadow,
                        .in_light_depth = object.in_light_depth(),
                        .emissive = object.emissive,
                        .moving = object.motion || object.light_id != 0,
                        .enclosed = object.enclosed,
                        .exists = true,
                        .bounds_local = {},
                        .world_from_object = glm::mat4(1),
                        .normal_matrix = glm::mat3(1),
                        .bounds_world = {}});
    for (const sim::Part& part : object.parts) {
      const auto index = static_cast<std::size_t>(part.material);
      const Material& material = scene.materials.at(index);
      parts_.push_back({.object = i,
                        .first_vertex = static_cast<std::int32_t>(vertices.size()),
                        .first_index = static_cast<std::uint32_t>(indices.size()),
                        .index_count = static_cast<std::uint32_t>(part.mesh.indices.size()),
                        .texture = index,
                        .base_color = material.base_color,
                        .alpha_cutoff = material.alpha_cutoff,
                        .double_sided = material.double_sided,
                        .bounds_local = bounds_of(part.mesh),
                        .bounds_world = {}});
      objects_.back().bounds_local.add(parts_.back().bounds_local);
      vertices.insert(vertices.end(), part.mesh.vertices.begin(), part.mesh.vertices.end());
      indices.insert(indices.end(), part.mesh.indices.begin(), part.mesh.indices.end());
    }
    place(i, object.world_from_object);
  }
  const Mesh unit = box(glm::vec3(1));
  box_vertex_ = static_cast<std::int32_t>(vertices.size());
  box_index_ = static_cast<std::uint32_t>(indices.size());
  box_index_count_ = static_cast<std::uint32_t>(unit.indices.size());
  vertices.insert(vertices.end(), unit.vertices.begin(), unit.vertices.end());
  indices.insert(indices.end(), unit.indices.begin(), unit.indices.end());

  vertices_ = make_buffer();
  indices_ = make_buffer();
  vertex_array_ = make_vertex_array();
  glNamedBufferStorage(vertices_.get(), static_cast<GLsizeiptr>(vertices.size() * sizeof(Vertex)), vertices.data(), 0);
  glNamedBufferStorage(indices_.get(), static_cast<GLsizeiptr>(indices.size() * sizeof(std::uint32_t)), indices.data(),
                       0);
  glVertexArrayVertexBuffer(vertex_array_.get(), 0, vertices_.get(), 0, sizeof(Vertex));
  glVertexArrayElementBuffer(vertex_array_.get(), indices_.get());
  const auto attribute = [&](GLuint location, GLint size, std::size_t offset) {
    glEnableVertexArrayAttrib(vertex_array_.get(), location);
    glVertexArrayAttribFormat(vertex_array_.get(), location, size, GL_FLOAT, GL_FALSE, static_cast<GLuint>(offset));
    glVertexArrayAttribBinding(vertex_array_.get(), location, 0);
  };
  attribute(kPosition, 3, offsetof(Vertex, position));
  attribute(kNormal, 3, offsetof(Vertex, normal));
  attribute(kUv, 2, offsetof(Vertex, uv));
  glEnableVertexArrayAttrib(vertex_array_.get(), kTint);
  glVertexArrayAttribFormat(vertex_array_.get(), kTint, 4, GL_UNSIGNED_BYTE, GL_TRUE, offsetof(Vertex, tint));
  glVertexArrayAttribBinding(vertex_array_.get(), kTint, 0);
}

void GpuScene::upload_textures(const Scene& scene, float anisotropy) {
  const Image white{.width = 1, .height = 1, .rgba = {255, 255, 255, 255}};
  for (const Material& material : scene.materials) {
    const Image& image = material.image >= 0 ? scene.images.at(static_cast<std::size_t>(material.image)) : white;
    textures_.push_back(upload(image, material.repeat, anisotropy));
  }
}

void GpuScene::place(std::size_t object, const glm::mat4& world_from_object) {
  ObjectState& state = objects_[object];
  state.world_from_object = world_from_object;
  state.normal_matrix = glm::inverseTranspose(glm::mat3(world_from_object));
  state.bounds_world = {};
  for (Part& part : parts_) {
    if (part.object != object) continue;
    part.bounds_world = transformed(part.bounds_local, world_from_object);
    state.bounds_world.add(part.bounds_world);
  }
}

ObjectChanges GpuScene::set_time(const Scene& scene, double time_s, std::span<const splatbus_light_source> sources) {
  ObjectChanges changes;
  std::vector<splatbus_object> listed;
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
        moved = true;
      }
    }
    if (!moved) continue;
    changes.any = true;
    if (!state.in_light_depth) continue;
    if (was) changes.moved.push_back(before);
    if (state.exists) changes.moved.push_back(state.bounds_world);
  }
  listed_ = std::move(listed);
  return changes;
}

void GpuScene::draw_part(const Part& part, const ShaderVariant& variant, GLuint program) const {
  const ObjectState& object = objects_[part.object];
  glUseProgram(program);
  glUniformMatrix4fv(kWorldFromObject, 1, GL_FALSE, glm::value_ptr(object.world_from_object));
  const bool shade = variant.kind == ShaderVariant::Kind::Shade;
  if (variant.kind == ShaderVariant::Kind::Geometry || (variant.lit && !variant.emissive)) {
    glUniformMatrix3fv(kNormalMatrix, 1, GL_FALSE, glm::value_ptr(object.normal_matrix));
  }
  if (variant.kind == ShaderVariant::Kind::Geometry) glUniform1ui(kObjectId, object.id);
  if (shade) glUniform3fv(kBaseColor, 1, glm::value_ptr(part.base_color));
  if (variant.holes) glUniform1f(kAlphaCutoff, part.alpha_cutoff);
  if (shade || variant.holes) glBindTextureUnit(0, textures_[part.texture].get());
  if (part.double_sided) {
    glDisable(GL_CULL_FACE);
  } else {
    glEnable(GL_CULL_FACE);
  }
  glDrawElementsBaseVertex(GL_TRIANGLES, static_cast<GLsizei>(part.index_count), GL_UNSIGNED_INT,
                           // NOLINTNEXTLINE(performance-no-int-to-ptr): OpenGL's offset into the bound buffer
                           reinterpret_cast<const void*>(part.first_index * sizeof(std::uint32_t)), part.first_vertex);
}

}  // namespace splatbus::sim
