#include "sim/depth_maps.h"

#include <array>
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
  framebuffer_ = make_framebuffer();
  glNamedFramebufferDrawBuffer(framebuffer_.get(), GL_NONE);
  glNamedFramebufferReadBuffer(framebuffer_.get(), GL_NONE);
}

void DepthMaps::draw(int layer, GpuScene& scene, const LightCamera& camera, const DepthPrograms& program_for) {
  glNamedFramebufferTextureLayer(framebuffer_.get(), GL_DEPTH_ATTACHMENT, layers_.get(), 0, layer);
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.get());
  glViewport(0, 0, size_, size_);
  constexpr float kFar = 1;
  glClearNamedFramebufferfv(framebuffer_.get(), GL_DEPTH, 0, &kFar);
  const glm::mat4 clip_from_world =
      clip_from_camera(camera.camera, camera.projection) * camera_from_world(camera.camera);
  scene.draw(clip_from_world, {.kind = ShaderVariant::Kind::Depth}, Shown::ShadowCasters,
             [&](const ShaderVariant& variant) {
               const GLuint program = program_for(variant);
               glProgramUniformMatrix4fv(program, kClipFromWorld, 1, GL_FALSE, glm::value_ptr(clip_from_world));
               return program;
             });
}

}  // namespace splatbus::sim
