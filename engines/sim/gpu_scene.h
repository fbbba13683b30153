#pragma once

#include <array>
#include <cstdint>
#include <glm/glm.hpp>
#include <span>
#include <tuple>
#include <utility>
#include <vector>

#include "gl/objects.h"
#include "sim/scene.h"
#include "sim/shaders.h"
#include "sim/texture_arrays.h"

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

  /// Draws what may be seen with the programs that `program_for` gives for parts with and without holes, emissive or
  /// not; of those that have a program, an array of textures and their sides in common the nearest first, in one call.
  /// Framebuffer, viewport and the uniforms that do not depend on the part are the caller's.
  ///
  /// Enclosed objects come last, and only those of whose boxes anything is seen past the others: the picture is the
  /// same as if all of them were drawn.
  template <class ProgramFor>
  void draw(const glm::mat4& clip_from_world, const ShaderVariant& variant, Shown shown, ProgramFor&& program_for) {
    const VisibleParts visible = visible_parts(clip_from_world, shown);
    glBindVertexArray(vertex_array_.get());
    draw_list(open_, list_commands(visible.open, variant, open_), variant, program_for);
    if (visible.enclosed.empty()) return;
    const std::vector<Group> groups = list_commands(visible.enclosed, variant, enclosed_);
    if (cull_) leave_out_unseen(visible.enclosed, clip_from_world);
    draw_list(enclosed_, groups, variant, program_for);
  }

 private:
  struct MeshRange {
    std::int32_t first_vertex = 0;
    std::uint32_t first_index = 0, index_count = 0;
  };
  struct Part {
    std::size_t object;
    MeshRange mesh;
    TextureArrays::Place texture;
    glm::vec3 base_color;
    float alpha_cutoff;
    bool double_sided;
    Bounds bounds_local, bounds_world;
  };
  struct ObjectState {
    std::uint32_t id;
    bool casts_shadow, in_light_depth, emissive, moving, enclosed;
    bool exists;
    std::size_t first_part, part_count;
    Bounds box;  ///< its own frame; a little more than all of its parts
    glm::mat4 world_from_object;
    Bounds bounds_world;
  };
  /// What shaders read of a part, or of an object's box.
  struct InstanceData {
    glm::mat4 world_from_part;
    glm::mat3 normal_matrix;
    glm::vec3 base_color;
    float alpha_cutoff;
    std::uint32_t object_id, layer, object;
  };
  /// As OpenGL reads it.
  struct Command {
    std::uint32_t index_count, instance_count, first_index;
    std::int32_t first_vertex;
    std::uint32_t first_instance;  ///< the part, or behind all of them the object's box
  };
  /// Commands in a row that one call draws.
  struct Group {
    bool holes, emissive, double_sided;
    std::size_t texture_array;
    std::size_t first = 0, count = 0;
    [[nodiscard]] auto kind() const { return std::tuple(holes, emissive, double_sided, texture_array); }
  };
  struct CommandList {
    GlBuffer buffer;
    std::size_t room = 0;
    std::vector<Command> commands;
  };

  struct VisibleParts {
    std::vector<const Part*> open, enclosed;
  };
  [[nodiscard]] bool shows(const ObjectState& object, Shown shown) const;
  [[nodiscard]] VisibleParts visible_parts(const glm::mat4& clip_from_world, Shown shown) const;
  /// Sends the parts' commands to the GPU.
  std::vector<Group> list_commands(const std::vector<const Part*>& parts, const ShaderVariant& variant,
                                   CommandList& list) const;
  static void send(CommandList& list);
  [[nodiscard]] static Command command(const MeshRange& mesh, std::size_t instance);
  /// Takes the instances of enclosed_ whose objects' boxes are behind what was drawn. The answers stay on the GPU: to
  /// wait for them here would take a turn of everybody who shares it.
  void leave_out_unseen(const std::vector<const Part*>& parts, const glm::mat4& clip_from_world);
  template <class ProgramFor>
  void draw_list(const CommandList& list, const std::vector<Group>& groups, ShaderVariant variant,
                 ProgramFor&& program_for) const {
    glBindBuffer(GL_DRAW_INDIRECT_BUFFER, list.buffer.get());
    for (const Group& group : groups) {
      variant.holes = group.holes;
      variant.emissive = group.emissive;
      draw_group(group, program_for(std::as_const(variant)));
    }
  }
  void draw_group(const Group& group, GLuint program) const;
  void add_meshes(const Scene& scene);
  void add_attributes();
  /// On the host alone.
  void place(std::size_t object, const glm::mat4& world_from_object);
  void send_placed(const std::vector<std::size_t>& objects);

  bool cull_;
  TextureArrays textures_;
  GlBuffer vertices_, indices_;
  std::vector<InstanceData> instance_data_;  ///< of the parts, then of the objects' boxes
  GlBuffer instances_;
  GlVertexArray vertex_array_;
  std::vector<Part> parts_;
  std::vector<ObjectState> objects_;
  std::vector<splatbus_object> listed_;
  CommandList open_, enclosed_, boxes_;

  MeshRange box_;  ///< of 1 m about the origin
  GlProgram box_program_, instance_program_;
  GlBuffer object_of_part_, seen_;  ///< by object, whether anything of its box was seen
};

}  // namespace splatbus::sim
