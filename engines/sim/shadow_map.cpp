#include "sim/shadow_map.h"

#include <algorithm>
#include <array>
#include <glm/gtc/matrix_inverse.hpp>
#include <glm/gtc/matrix_transform.hpp>
#include <glm/gtc/type_ptr.hpp>

#include "sim/projection.h"

namespace splatbus::sim {

ShadowMap::ShadowMap(int size, const Bounds& casters, const Bounds& receivers)
    : size_(size), casters_(casters), receivers_(receivers), depth_(make_texture(GL_TEXTURE_2D)) {
  glTextureStorage2D(depth_.get(), 1, GL_DEPTH_COMPONENT32F, size, size);
  glTextureParameteri(depth_.get(), GL_TEXTURE_MIN_FILTER, GL_LINEAR);
  glTextureParameteri(depth_.get(), GL_TEXTURE_MAG_FILTER, GL_LINEAR);
  glTextureParameteri(depth_.get(), GL_TEXTURE_COMPARE_MODE, GL_COMPARE_REF_TO_TEXTURE);
  glTextureParameteri(depth_.get(), GL_TEXTURE_COMPARE_FUNC, GL_LEQUAL);
  glTextureParameteri(depth_.get(), GL_TEXTURE_WRAP_S, GL_CLAMP_TO_BORDER);
  glTextureParameteri(depth_.get(), GL_TEXTURE_WRAP_T, GL_CLAMP_TO_BORDER);
  constexpr std::array<float, 4> kFar{1, 1, 1, 1};
  glTextureParameterfv(depth_.get(), GL_TEXTURE_BORDER_COLOR, kFar.data());
  framebuffer_ = make_framebuffer();
  glNamedFramebufferTexture(framebuffer_.get(), GL_DEPTH_ATTACHMENT, depth_.get(), 0);
  glNamedFramebufferDrawBuffer(framebuffer_.get(), GL_NONE);
  glNamedFramebufferReadBuffer(framebuffer_.get(), GL_NONE);
}

void ShadowMap::draw(GpuScene& scene, const glm::vec3& sun_direction,
                     const std::function<GLuint(const ShaderVariant&)>& program_for) {
  ++times_drawn_;
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.get());
  glViewport(0, 0, size_, size_);
  constexpr float kFar = 1;
  glClearNamedFramebufferfv(framebuffer_.get(), GL_DEPTH, 0, &kFar);
  if (casters_.empty()) return;

  const auto size = static_cast<std::uint32_t>(size_);
  splatbus_camera camera = fit_light_camera(casters_, sun_direction, size, size);
  // The depth range takes in the receivers: what lies beyond the far plane would fail every comparison.
  const glm::mat4 view = camera_from_world(camera);
  const Bounds seen = transformed(receivers_, view);
  camera.far_m = std::max(camera.far_m, seen.high.z + 0.1F);

  const glm::mat4 clip_from_world = clip_from_camera(camera) * view;
  uv_a_metre_ = {camera.fx / static_cast<float>(size_), camera.fy / static_cast<float>(size_)};
  metres_a_depth_ = camera.far_m - camera.near_m;
  const glm::mat4 unit_from_clip = glm::scale(glm::translate(glm::mat4(1), glm::vec3(0.5F)), glm::vec3(0.5F));
  shadow_from_world_ = unit_from_clip * clip_from_world;

  scene.draw(clip_from_world, {.kind = ShaderVariant::Kind::Depth}, true, [&](const ShaderVariant& variant) {
    const GLuint program = program_for(variant);
    glProgramUniformMatrix4fv(program, kClipFromWorld, 1, GL_FALSE, glm::value_ptr(clip_from_world));
    return program;
  });
}

void ShadowMap::bind(GLuint program, float softness_m) const {
  constexpr float kGreatestSlope = 6;  // of the receiver, metres of depth a metre across
  constexpr float kLiftTexels = 1.5F;
  const glm::vec2 radius = softness_m * uv_a_metre_;
  const float across = 1 / std::min(uv_a_metre_.x, uv_a_metre_.y);
  const glm::vec4 filter{radius, kGreatestSlope * across / metres_a_depth_,
                         kLiftTexels * across / static_cast<float>(size_)};
  const glm::mat3 shadow_normal = glm::inverseTranspose(glm::mat3(shadow_from_world_));
  glProgramUniformMatrix4fv(program, kShadowFromWorld, 1, GL_FALSE, glm::value_ptr(shadow_from_world_));
  glProgramUniformMatrix3fv(program, kShadowNormal, 1, GL_FALSE, glm::value_ptr(shadow_normal));
  glProgramUniform4fv(program, kShadowFilter, 1, glm::value_ptr(filter));
  glBindTextureUnit(1, depth_.get());
}

}  // namespace splatbus::sim
