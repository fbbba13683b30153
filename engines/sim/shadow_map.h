#pragma once

#include <functional>
#include <glm/glm.hpp>

#include "sim/gl_objects.h"
#include "sim/gpu_scene.h"

namespace splatbus::sim {

/// The sun's depth map over everything that casts a shadow. What lies outside of it is lit.
class ShadowMap {
 public:
  /// `casters` and `receivers` bound the scene in the world, over all time.
  ShadowMap(int size, const Bounds& casters, const Bounds& receivers);

  /// Draws the casters as they stand, with the Depth program variants of `program_for`.
  void draw(GpuScene& scene, const glm::vec3& sun_direction,
            const std::function<GLuint(const ShaderVariant&)>& program_for);

  /// Sets a lit shading program's shadow uniforms and binds the map to texture unit 1.
  void bind(GLuint program, float softness_m) const;

  [[nodiscard]] std::uint64_t times_drawn() const { return times_drawn_; }

 private:
  int size_;
  Bounds casters_, receivers_;
  GlTexture depth_;
  GlFramebuffer framebuffer_;
  glm::mat4 shadow_from_world_{1};
  glm::vec2 uv_a_metre_{1};
  float metres_a_depth_ = 1;
  std::uint64_t times_drawn_ = 0;
};

}  // namespace splatbus::sim
