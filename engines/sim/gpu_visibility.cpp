// Which parts of a scene are drawn.
#include <algorithm>
#include <glm/gtc/type_ptr.hpp>
#include <utility>

#include "sim/gpu_scene.h"
#include "sim/projection.h"

namespace splatbus::sim {
namespace {

/// Whether a box comes before the near plane, so that its faces do not hide all that is in it.
bool reaches_camera(const Bounds& bounds, const glm::mat4& clip_from_box) {
  for (int i = 0; i < 8; ++i) {
    const glm::vec4 p = clip_from_box * glm::vec4(bounds.corner(i), 1);
    if (p.z <= -p.w) return true;
  }
  return false;
}

}  // namespace

bool GpuScene::shows(const ObjectState& object, Shown shown) const {
  switch (shown) {
    case Shown::InLightDepth:
      return object.in_light_depth;
    case Shown::ShadowCasters:
      return object.casts_shadow;
    case Shown::StillShadowCasters:
      return object.casts_shadow && !object.moving;
    case Shown::MovingShadowCasters:
      return object.casts_shadow && object.moving;
    default:
      return true;
  }
}

std::vector<Bounds> GpuScene::moving_bounds() const {
  std::vector<Bounds> bounds;
  for (const ObjectState& object : objects_) {
    if (object.exists && shows(object, Shown::MovingShadowCasters)) bounds.push_back(object.bounds_world);
  }
  return bounds;
}

GpuScene::VisibleParts GpuScene::visible_parts(const glm::mat4& clip_from_world, Shown shown) const {
  const Frustum frustum(clip_from_world);
  std::vector<std::pair<float, const Part*>> visible;
  for (const ObjectState& object : objects_) {
    if (!object.exists || !shows(object, shown)) continue;
    if (cull_ && !frustum.may_show(object.bounds_world)) continue;
    for (const Part& part : std::span(parts_).subspan(object.first_part, object.part_count)) {
      if (part.mesh.index_count == 0 || (cull_ && !frustum.may_show(part.bounds_world))) continue;
      visible.emplace_back(frustum.farthest(part.bounds_world), &part);
    }
  }
  std::ranges::stable_sort(visible, {}, &std::pair<float, const Part*>::first);
  VisibleParts parts;
  for (const auto& entry : visible) {
    (objects_[entry.second->object].enclosed ? parts.enclosed : parts.open).push_back(entry.second);
  }
  return parts;
}

std::vector<GpuScene::Group> GpuScene::list_commands(const std::vector<const Part*>& parts,
                                                     const ShaderVariant& variant, CommandList& list) const {
  const bool shade = variant.kind == ShaderVariant::Kind::Shade;
  std::vector<std::pair<Group, const Part*>> drawn;
  drawn.reserve(parts.size());
  for (const Part* part : parts) {
    const bool holes = part->alpha_cutoff > 0;
    drawn.push_back({{.holes = holes,
                      .emissive = variant.lit && objects_[part->object].emissive,
                      .double_sided = part->double_sided,
                      .texture_array = shade || holes ? part->texture.array : 0},
                     part});
  }
  std::ranges::stable_sort(drawn, {}, [](const auto& entry) { return entry.first.kind(); });
  std::vector<Group> groups;
  list.commands.clear();
  for (const auto& [group, part] : drawn) {
    if (groups.empty() || groups.back().kind() != group.kind()) {
      groups.push_back(group);
      groups.back().first = list.commands.size();
    }
    ++groups.back().count;
    list.commands.push_back(command(part->mesh, static_cast<std::size_t>(part - parts_.data())));
  }
  send(list);
  return groups;
}

GpuScene::Command GpuScene::command(const MeshRange& mesh, std::size_t instance) {
  return {mesh.index_count, 1, mesh.first_index, mesh.first_vertex, static_cast<std::uint32_t>(instance)};
}

void GpuScene::send(CommandList& list) {
  const std::size_t count = list.commands.size();
  if (list.room < count) {
    list.room = 2 * count;
    list.buffer = make_buffer();
    glNamedBufferStorage(list.buffer.get(), static_cast<GLsizeiptr>(list.room * sizeof(Command)), nullptr,
                         GL_DYNAMIC_STORAGE_BIT);
  }
  if (count == 0) return;
  glNamedBufferSubData(list.buffer.get(), 0, static_cast<GLsizeiptr>(count * sizeof(Command)), list.commands.data());
}

void GpuScene::draw_group(const Group& group, GLuint program) const {
  glUseProgram(program);
  glBindTextureUnit(kBaseTextures, textures_.array(group.texture_array));
  if (group.double_sided) {
    glDisable(GL_CULL_FACE);
  } else {
    glEnable(GL_CULL_FACE);
  }
  glMultiDrawElementsIndirect(GL_TRIANGLES, GL_UNSIGNED_INT,
                              // NOLINTNEXTLINE(performance-no-int-to-ptr): OpenGL's offset into the bound buffer
                              reinterpret_cast<const void*>(group.first * sizeof(Command)),
                              static_cast<GLsizei>(group.count), 0);
}

void GpuScene::leave_out_unseen(const std::vector<const Part*>& parts, const glm::mat4& clip_from_world) {
  constexpr GLuint kCommandsAGroup = 64;  // of the shader
  std::vector<std::uint32_t> seen(objects_.size(), 1);
  boxes_.commands.clear();
  for (const Part* part : parts) {
    const ObjectState& object = objects_[part->object];
    if (seen[part->object] == 0 || reaches_camera(object.box, clip_from_world * object.world_from_object)) continue;
    seen[part->object] = 0;
    boxes_.commands.push_back(command(box_, parts_.size() + part->object));
  }
  if (boxes_.commands.empty()) return;
  send(boxes_);
  glNamedBufferSubData(seen_.get(), 0, static_cast<GLsizeiptr>(seen.size() * sizeof(seen[0])), seen.data());
  glBindBufferBase(GL_SHADER_STORAGE_BUFFER, kSeen, seen_.get());
  glBindBufferBase(GL_SHADER_STORAGE_BUFFER, kCommands, enclosed_.buffer.get());
  glBindBufferBase(GL_SHADER_STORAGE_BUFFER, kObjectOfPart, object_of_part_.get());
  glBindBuffer(GL_DRAW_INDIRECT_BUFFER, boxes_.buffer.get());
  glUseProgram(box_program_.get());
  glProgramUniformMatrix4fv(box_program_.get(), kClipFromWorld, 1, GL_FALSE, glm::value_ptr(clip_from_world));
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glDepthMask(GL_FALSE);
  glEnable(GL_CULL_FACE);
  glMultiDrawElementsIndirect(GL_TRIANGLES, GL_UNSIGNED_INT, nullptr, static_cast<GLsizei>(boxes_.commands.size()), 0);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glDepthMask(GL_TRUE);
  glMemoryBarrier(GL_SHADER_STORAGE_BARRIER_BIT);
  const auto count = static_cast<GLuint>(enclosed_.commands.size());
  glUseProgram(instance_program_.get());
  glProgramUniform1ui(instance_program_.get(), kCommandCount, count);
  glDispatchCompute((count + kCommandsAGroup - 1) / kCommandsAGroup, 1, 1);
  // The next list is written where this one lies.
  glMemoryBarrier(GL_COMMAND_BARRIER_BIT | GL_BUFFER_UPDATE_BARRIER_BIT);
}

}  // namespace splatbus::sim
