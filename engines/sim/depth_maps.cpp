#include "sim/depth_maps.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/gtc/type_ptr.hpp>

#include "sim/projection.h"

namespace splatbus::sim {
namespace {

void compare_linearly(GLuint texture) {
  glTextureParameteri(texture, GL_TEXTURE_MIN_FILTER, GL_LINEAR);
  glTextureParameteri(texture, GL_TEXTURE_MAG_FILTER, GL_LINEAR);
  glTextureParameteri(texture, GL_TEXTURE_COMPARE_MODE, GL_COMPARE_REF_TO_TEXTURE);
  glTextureParameteri(texture, GL_TEXTURE_COMPARE_FUNC, GL_LEQUAL);
  glTextureParameteri(texture, GL_TEXTURE_WRAP_S, GL_CLAMP_TO_BORDER);
  glTextureParameteri(texture, GL_TEXTURE_WRAP_T, GL_CLAMP_TO_BORDER);
  constexpr std::array<float, 4> kFar{1, 1, 1, 1};
  glTextureParameterfv(texture, GL_TEXTURE_BORDER_COLOR, kFar.data());
}

bool same_camera(const LightCamera& a, const LightCamera& b) {
  const auto values = [](const splatbus_camera& c) {
    const float *q = c.world_from_camera.rotation_wxyz, *t = c.world_from_camera.translation;
    return std::array{c.fx, c.fy, c.cx, c.cy, c.near_m, c.far_m, q[0], q[1], q[2], q[3], t[0], t[1], t[2]};
  };
  return a.projection == b.projection && values(a.camera) == values(b.camera);
}

}  // namespace

MapCamera map_camera(const LightCamera& light) {
  const splatbus_camera& camera = light.camera;
  const glm::mat4 rows = glm::transpose(camera_from_world(camera));
  const float depth_m = camera.far_m - camera.near_m;
  const glm::vec2 uv_a_metre{camera.fx / static_cast<float>(camera.width),
                             camera.fy / static_cast<float>(camera.height)};
  const glm::vec2 depth = light.projection == Projection::Pinhole
                              ? glm::vec2(camera.far_m / depth_m, camera.far_m * camera.near_m / depth_m)
                              : glm::vec2(-camera.near_m / depth_m, 1 / depth_m);
  return {rows[0], rows[1], rows[2], {uv_a_metre, depth}};
}

void DepthMaps::resize(int size, int layers) {
  if (size == size_ && layers == count_) return;
  size_ = size;
  count_ = layers;
  layers_ = make_texture(GL_TEXTURE_2D_ARRAY);
  glTextureStorage3D(layers_.get(), 1, GL_DEPTH_COMPONENT32F, size, size, layers);
  compare_linearly(layers_.get());
  GLuint view = 0;
  glGenTextures(1, &view);
  first_ = GlTexture(view);
  glTextureView(view, GL_TEXTURE_2D, layers_.get(), GL_DEPTH_COMPONENT32F, 0, 1, 0, 1);
  compare_linearly(view);
  still_layers_ = {};
  still_.clear();
  framebuffer_ = make_framebuffer();
  glNamedFramebufferDrawBuffer(framebuffer_.get(), GL_NONE);
  glNamedFramebufferReadBuffer(framebuffer_.get(), GL_NONE);
}

void DepthMaps::draw(int layer, GpuScene& scene, const LightCamera& camera, const DepthPrograms& program_for) {
  draw_into(layers_.get(), layer, true, Shown::ShadowCasters, scene, camera, program_for);
}

void DepthMaps::draw_what_moved(int layer, GpuScene& scene, const LightCamera& camera,
                                const DepthPrograms& program_for) {
  if (!still_layers_) {
    still_layers_ = make_texture(GL_TEXTURE_2D_ARRAY);
    glTextureStorage3D(still_layers_.get(), 1, GL_DEPTH_COMPONENT32F, size_, size_, count_);
    still_.resize(static_cast<std::size_t>(count_));
  }
  Still& still = still_.at(static_cast<std::size_t>(layer));
  if (!still.camera || !same_camera(*still.camera, camera)) {
    draw_into(still_layers_.get(), layer, true, Shown::StillShadowCasters, scene, camera, program_for);
    still = {camera, {{0, 0, size_, size_}}};
  }
  for (const Texels& texels : still.covered) copy_still(layer, texels);
  still.covered.clear();
  const glm::mat4 clip_from_world =
      clip_from_camera(camera.camera, camera.projection) * camera_from_world(camera.camera);
  for (const Bounds& bounds : scene.moving_bounds()) still.covered.push_back(texels_of(bounds, clip_from_world));
  if (!still.covered.empty()) {
    draw_into(layers_.get(), layer, false, Shown::MovingShadowCasters, scene, camera, program_for);
  }
}

void DepthMaps::copy_still(int layer, const Texels& texels) {
  if (texels.width <= 0 || texels.height <= 0) return;
  glCopyImageSubData(still_layers_.get(), GL_TEXTURE_2D_ARRAY, 0, texels.x, texels.y, layer, layers_.get(),
                     GL_TEXTURE_2D_ARRAY, 0, texels.x, texels.y, layer, texels.width, texels.height, 1);
}

DepthMaps::Texels DepthMaps::texels_of(const Bounds& bounds_world, const glm::mat4& clip_from_world) const {
  // Of an orthographic map: no corner is behind it.
  const Bounds clip = transformed(bounds_world, clip_from_world);
  const auto texel = [&](float at, int margin) {
    return std::clamp(static_cast<int>(std::floor((0.5F + 0.5F * at) * static_cast<float>(size_))) + margin, 0, size_);
  };
  const int x = texel(clip.low.x, -1), y = texel(clip.low.y, -1);
  return {x, y, texel(clip.high.x, 2) - x, texel(clip.high.y, 2) - y};
}

void DepthMaps::draw_into(GLuint texture, int layer, bool clear, Shown shown, GpuScene& scene,
                          const LightCamera& camera, const DepthPrograms& program_for) {
  glNamedFramebufferTextureLayer(framebuffer_.get(), GL_DEPTH_ATTACHMENT, texture, 0, layer);
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.get());
  glViewport(0, 0, size_, size_);
  constexpr float kFar = 1;
  if (clear) glClearNamedFramebufferfv(framebuffer_.get(), GL_DEPTH, 0, &kFar);
  const glm::mat4 clip_from_world =
      clip_from_camera(camera.camera, camera.projection) * camera_from_world(camera.camera);
  scene.draw(clip_from_world, {.kind = ShaderVariant::Kind::Depth}, shown, [&](const ShaderVariant& variant) {
    const GLuint program = program_for(variant);
    glProgramUniformMatrix4fv(program, kClipFromWorld, 1, GL_FALSE, glm::value_ptr(clip_from_world));
    return program;
  });
}

}  // namespace splatbus::sim
