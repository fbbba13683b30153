#pragma once

#include <array>
#include <span>
#include <vector>

#include "sim/gl_objects.h"
#include "sim/scene.h"
#include "sim/shaders.h"

namespace splatbus::sim {

/// Which objects are drawn.
enum class Shown { All, InLightDepth, ShadowCasters };

/// What a new instant has changed.
struct ObjectChanges {
  bool any = false;           ///< an object has moved, come or gone
  std::vector<Bounds> moved;  ///< where those were and are that depth maps show, in the world
};

/// A scene's meshes and textures on the GPU, and the transforms of one instant.
class GpuScene {
 public:
  GpuScene(const Scene& scene, float anisotropy);

  /// Sets transforms and existence for a time at which `sources` are the lights besides the sun.
  ObjectChanges set_time(const Scene& scene, double time_s, std::span<const splatbus_light_source> sources);
  /// Whatever exists and has a motion, or a flag of splatbus_object_flags, in the scene's order.
  [[nodiscard]] const std::vector<splatbus_object>& listed() const { return listed_; }

  /// Draws what may be seen, nearest first, with the program that `program_for` gives for parts with and without holes.
  /// Framebuffer, viewport and the uniforms that do not depend on the part are the caller's.
  template <class ProgramFor>
  void draw(const glm::mat4& clip_from_world, ShaderVariant variant, Shown shown, ProgramFor&& program_for) {
    glBindVertexArray(vertex_array_.get());
    for (const Part* part : visible_parts(clip_from_world, shown)) {
      variant.holes = part->alpha_cutoff > 0;
      variant.emissive = variant.lit && objects_[part->object].emissive;
      draw_part(*part, variant, program_for(variant));
    }
  }

 private:
  struct Part {
    std::size_t object;
    std::int32_t first_vertex;
    std::uint32_t first_index, index_count;
    std::size_t texture;
    glm::vec3 base_color;
    float alpha_cutoff;
    bool double_sided;
    Bounds bounds_local, bounds_world;
  };
  struct ObjectState {
    std::uint32_t id;
    bool casts_shadow, in_light_depth, emissive;
    bool exists;
    glm::mat4 world_from_object;
    glm::mat3 normal_matrix;
    Bounds bounds_world;
  };

  [[nodiscard]] std::vector<const Part*> visible_parts(const glm::mat4& clip_from_world, Shown shown) const;
  void draw_part(const Part& part, const ShaderVariant& variant, GLuint program) const;
  void upload_textures(const Scene& scene, float anisotropy);
  void place(std::size_t object, const glm::mat4& world_from_object);

  GlBuffer vertices_, indices_;
  GlVertexArray vertex_array_;
  std::vector<GlTexture> textures_;  ///< the last is plain white
  std::vector<Part> parts_;
  std::vector<ObjectState> objects_;
  std::vector<splatbus_object> listed_;
};

}  // namespace splatbus::sim
