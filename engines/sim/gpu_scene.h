#pragma once

#include <array>
#include <map>
#include <span>
#include <vector>

#include "gl/objects.h"
#include "sim/scene.h"
#include "sim/shaders.h"

namespace splatbus::sim {

/// Which objects are drawn. Those that are still have no motion and are no lamps; the others are moving.
enum class Shown { All, InLightDepth, ShadowCasters, StillShadowCasters, MovingShadowCasters };

/// What a new instant has changed.
struct ObjectChanges {
  bool any = false;           ///< an object has moved, come or gone
  std::vector<Bounds> moved;  ///< where those were and are that depth maps show, in the world
};

/// A scene's meshes and textures on the GPU, and the transforms of one instant.
class GpuScene {
 public:
  GpuScene(const Scene& scene, float anisotropy, bool cull);

  /// Sets transforms and existence for a time at which `sources` are the lights besides the sun.
  ObjectChanges set_time(const Scene& scene, double time_s, std::span<const splatbus_light_source> sources);
  /// Whatever exists and has a motion, or a flag of splatbus_object_flags, in the scene's order.
  [[nodiscard]] const std::vector<splatbus_object>& listed() const { return listed_; }

  /// In the world, of moving shadow casters that exist.
  [[nodiscard]] std::vector<Bounds> moving_bounds() const;

  /// Draws what may be seen, nearest first, with the program that `program_for` gives for parts with and without holes,
  /// and for depth alone. Framebuffer, viewport and the uniforms that do not depend on the part are the caller's.
  ///
  /// Enclosed objects come last, and only those of whose boxes anything is seen past the others: the picture is the
  /// same as if all of them were drawn.
  template <class ProgramFor>
  void draw(const glm::mat4& clip_from_world, const ShaderVariant& variant, Shown shown, ProgramFor&& program_for) {
    glBindVertexArray(vertex_array_.get());
    VisibleParts visible = visible_parts(clip_from_world, shown);
    draw_parts(visible.open, variant, program_for, {});
    SeenQueries seen;
    if (cull_ && !visible.enclosed.empty()) {
      seen = ask_what_is_seen(visible.enclosed, clip_from_world,
                              program_for(ShaderVariant{.kind = ShaderVariant::Kind::Depth}));
    }
    draw_parts(visible.enclosed, variant, program_for, seen);
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
    bool casts_shadow, in_light_depth, emissive, moving, enclosed;
    bool exists;
    Bounds bounds_local;
    glm::mat4 world_from_object;
    glm::mat3 normal_matrix;
    Bounds bounds_world;
  };

  struct VisibleParts {
    std::vector<const Part*> open, enclosed;
  };
  [[nodiscard]] bool shows(const ObjectState& object, Shown shown) const;
  [[nodiscard]] VisibleParts visible_parts(const glm::mat4& clip_from_world, Shown shown) const;
  using SeenQueries = std::map<std::size_t, GLuint>;  ///< by object
  /// Whether anything of their objects' boxes is before what was drawn. The answers stay on the GPU, which draws by
  /// them: to wait for them here would take a turn of everybody who shares it.
  SeenQueries ask_what_is_seen(const std::vector<const Part*>& parts, const glm::mat4& clip_from_world,
                               GLuint depth_program);
  template <class ProgramFor>
  void draw_parts(const std::vector<const Part*>& parts, ShaderVariant variant, ProgramFor&& program_for,
                  const SeenQueries& seen) {
    for (const Part* part : parts) {
      variant.holes = part->alpha_cutoff > 0;
      variant.emissive = variant.lit && objects_[part->object].emissive;
      const GLuint program = program_for(variant);
      const auto query = seen.find(part->object);
      if (query != seen.end()) glBeginConditionalRender(query->second, GL_QUERY_WAIT);
      draw_part(*part, variant, program);
      if (query != seen.end()) glEndConditionalRender();
    }
  }
  void draw_part(const Part& part, const ShaderVariant& variant, GLuint program) const;
  void upload_textures(const Scene& scene, float anisotropy);
  void place(std::size_t object, const glm::mat4& world_from_object);

  GlBuffer vertices_, indices_;
  GlVertexArray vertex_array_;
  std::vector<GlTexture> textures_;  ///< the last is plain white
  std::vector<Part> parts_;
  std::vector<ObjectState> objects_;
  std::vector<splatbus_object> listed_;
  std::vector<GlQuery> queries_;
  std::int32_t box_vertex_ = 0;  ///< the first of a box of 1 m about the origin
  std::uint32_t box_index_ = 0, box_index_count_ = 0;
  bool cull_;
};

}  // namespace splatbus::sim
