#pragma once

#include <functional>
#include <glm/glm.hpp>
#include <optional>
#include <vector>

#include "gl/objects.h"
#include "sim/gpu_scene.h"
#include "sim/light_maps.h"

namespace splatbus::sim {

/// The Depth program of a variant.
using DepthPrograms = std::function<GLuint(const ShaderVariant&)>;

/// A light's camera as shaders have it, `DepthMap` there: rows of camera_from_world; uv a metre (2), for a pinhole
/// camera at 1 m, and the two numbers z, w that make depth in [0, 1] of metres d along the axis: z - w / d for a
/// pinhole camera, z + w d for an orthographic one.
struct MapCamera {
  glm::vec4 right{0}, down{0}, forward{0}, scale{1};
};
[[nodiscard]] MapCamera map_camera(const LightCamera& camera);

/// Square depth maps of one size, layers of one texture that shaders compare with. What lies outside of a map is lit.
///
/// What is still can be kept apart, so that where only other things have moved no more than those are drawn again: the
/// nearer of two depths does not depend on their order.
class DepthMaps {
 public:
  /// Forgets what was drawn unless size and number of layers (1 at least) are as before.
  void resize(int size, int layers);

  /// Draws what casts shadows, as the light's camera sees it.
  void draw(int layer, GpuScene& scene, const LightCamera& camera, const DepthPrograms& program_for);
  /// The same. What is still is drawn only when the camera is another than at the layer's last time.
  void draw_what_moved(int layer, GpuScene& scene, const LightCamera& camera, const DepthPrograms& program_for);

  [[nodiscard]] int size() const { return size_; }
  /// GL_TEXTURE_2D_ARRAY.
  [[nodiscard]] GLuint layers() const { return layers_.get(); }
  /// The first layer, GL_TEXTURE_2D.
  [[nodiscard]] GLuint first() const { return first_.get(); }

 private:
  struct Texels {
    int x = 0, y = 0, width = 0, height = 0;
  };
  struct Still {
    std::optional<LightCamera> camera;
    std::vector<Texels> covered;  ///< of the layer, by what moves
  };
  void draw_into(GLuint texture, int layer, bool clear, Shown shown, GpuScene& scene, const LightCamera& camera,
                 const DepthPrograms& program_for);
  void copy_still(int layer, const Texels& texels);
  [[nodiscard]] Texels texels_of(const Bounds& bounds_world, const glm::mat4& clip_from_world) const;

  int size_ = 0, count_ = 0;
  GlTexture layers_, first_;
  GlTexture still_layers_;    ///< made when they are first needed
  std::vector<Still> still_;  ///< by layer
  GlFramebuffer framebuffer_;
};

}  // namespace splatbus::sim
