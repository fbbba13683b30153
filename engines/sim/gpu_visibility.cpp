// Which parts of a scene are drawn.
#include <algorithm>
#include <glm/gtc/matrix_transform.hpp>
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
  std::vector<std::pair<float, const Part*>> visible;
  for (const Part& part : parts_) {
    const ObjectState& object = objects_[part.object];
    if (part.index_count == 0 || !object.exists || !shows(object, shown)) continue;
    if (cull_ && !may_be_visible(part.bounds_world, clip_from_world)) continue;
    float farthest = -1e30F;
    for (int i = 0; i < 8; ++i) {
      farthest = std::max(farthest, (clip_from_world * glm::vec4(part.bounds_world.corner(i), 1)).w);
    }
    visible.emplace_back(farthest, &part);
  }
  std::ranges::stable_sort(visible, {}, &std::pair<float, const Part*>::first);
  VisibleParts parts;
  for (const auto& entry : visible) {
    (objects_[entry.second->object].enclosed ? parts.enclosed : parts.open).push_back(entry.second);
  }
  return parts;
}

GpuScene::SeenQueries GpuScene::ask_what_is_seen(const std::vector<const Part*>& parts,
                                                 const glm::mat4& clip_from_world, GLuint depth_program) {
  constexpr float kMargin_m = 0.01F;  // surfaces on the box's own faces are behind it
  SeenQueries asked;
  glUseProgram(depth_program);
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glDepthMask(GL_FALSE);
  glEnable(GL_CULL_FACE);
  for (const Part* part : parts) {
    const ObjectState& object = objects_[part->object];
    if (asked.contains(part->object)) continue;
    Bounds around = object.bounds_local;
    around.low -= kMargin_m;
    around.high += kMargin_m;
    if (reaches_camera(around, clip_from_world * object.world_from_object)) continue;
    if (asked.size() == queries_.size()) queries_.push_back(make_query(GL_ANY_SAMPLES_PASSED));
    const GLuint query = queries_[asked.size()].get();
    asked.emplace(part->object, query);
    const glm::mat4 world_from_box = glm::scale(
        glm::translate(object.world_from_object, (around.low + around.high) / 2.0F), around.high - around.low);
    glUniformMatrix4fv(kWorldFromObject, 1, GL_FALSE, glm::value_ptr(world_from_box));
    glBeginQuery(GL_ANY_SAMPLES_PASSED, query);
    glDrawElementsBaseVertex(GL_TRIANGLES, static_cast<GLsizei>(box_index_count_), GL_UNSIGNED_INT,
                             // NOLINTNEXTLINE(performance-no-int-to-ptr): OpenGL's offset into the bound buffer
                             reinterpret_cast<const void*>(box_index_ * sizeof(std::uint32_t)), box_vertex_);
    glEndQuery(GL_ANY_SAMPLES_PASSED);
  }
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glDepthMask(GL_TRUE);
  return asked;
}

}  // namespace splatbus::sim
