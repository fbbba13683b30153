#include <array>
#include <glm/gtc/type_ptr.hpp>
#include <span>
#include <vector>

#include "sim/projection.h"
#include "sim/renderer_impl.h"

namespace splatbus::sim {
namespace {

void set_draw_buffers(const GlFramebuffer& framebuffer, std::span<const bool> wanted) {
  std::vector<GLenum> buffers;
  for (std::size_t i = 0; i < wanted.size(); ++i) {
    buffers.push_back(wanted[i] ? GL_COLOR_ATTACHMENT0 + static_cast<GLenum>(i) : static_cast<GLenum>(GL_NONE));
  }
  glNamedFramebufferDrawBuffers(framebuffer.get(), static_cast<GLsizei>(buffers.size()), buffers.data());
}

}  // namespace

void Renderer::Impl::shade(const LightCamera& view, bool lit, bool albedo, Readback& readback) {
  const splatbus_camera& camera = view.camera;
  const splatbus_light light = instant.whole_light();
  ShaderVariant variant_of_all{.lit = lit, .albedo = albedo, .supersample = options.supersample};
  if (lit) {
    const float* eye = camera.world_from_camera.translation;
    lighting.update(gpu, light, {eye[0], eye[1], eye[2]}, [&](const ShaderVariant& v) { return program(v); });
    variant_of_all = lighting.variant(variant_of_all);
  }
  Targets& target = targets.get(camera.width, camera.height, true, false);
  const glm::mat4 clip_from_world = clip_from_camera(camera, view.projection) * camera_from_world(camera);
  const std::array<bool, 2> wanted{lit, albedo};
  set_draw_buffers(target.shade, wanted);
  glBindFramebuffer(GL_FRAMEBUFFER, target.shade.get());
  glViewport(0, 0, static_cast<GLsizei>(camera.width) * options.supersample,
             static_cast<GLsizei>(camera.height) * options.supersample);
  const float* behind = instant.light.background;
  const std::array<float, 4> background{behind[0], behind[1], behind[2], 0};
  constexpr std::array<float, 4> kNothing{};
  constexpr float kFar = 1;
  (options.samples > 1 ? glEnable : glDisable)(GL_MULTISAMPLE);
  if (lit) glClearNamedFramebufferfv(target.shade.get(), GL_COLOR, 0, background.data());
  if (albedo) glClearNamedFramebufferfv(target.shade.get(), GL_COLOR, 1, kNothing.data());
  glClearNamedFramebufferfv(target.shade.get(), GL_DEPTH, 0, &kFar);

  if (lit && scene.lighting.clouds && view.projection == Projection::Pinhole) {
    set_draw_buffers(target.shade, std::array{true, false});
    sky.draw(camera, instant.light);
    set_draw_buffers(target.shade, wanted);
  }

  std::map<GLuint, bool> prepared;
  gpu.draw(clip_from_world, variant_of_all, Shown::All, [&](const ShaderVariant& variant) {
    const GLuint made = program(variant);
    if (std::exchange(prepared[made], true)) return made;
    glProgramUniformMatrix4fv(made, kClipFromWorld, 1, GL_FALSE, glm::value_ptr(clip_from_world));
    if (variant.lit && !variant.emissive) lighting.bind(made, light);
    return made;
  });

  GlProgram& resolve = resolve_programs[{lit, albedo}];
  if (!resolve) resolve = build_resolve_program(options.supersample, options.samples, lit, albedo);
  glBindFramebuffer(GL_FRAMEBUFFER, target.resolve.get());
  set_draw_buffers(target.resolve, wanted);
  glViewport(0, 0, static_cast<GLsizei>(camera.width), static_cast<GLsizei>(camera.height));
  glDisable(GL_DEPTH_TEST);
  glUseProgram(resolve.get());
  glBindTextureUnit(0, target.lit_samples.get());
  glBindTextureUnit(1, target.albedo_samples.get());
  glBindVertexArray(no_vertices.get());
  glDisable(GL_CULL_FACE);
  glDrawArrays(GL_TRIANGLES, 0, 3);
  glEnable(GL_DEPTH_TEST);
  const auto take = [&](splatbus_buffer buffer, GLenum attachment) {
    readback.take({.buffer = buffer,
                   .framebuffer = target.resolve.get(),
                   .attachment = attachment,
                   .format = GL_RGBA,
                   .type = GL_UNSIGNED_BYTE,
                   .width = camera.width,
                   .height = camera.height,
                   .bytes = std::size_t{4} * camera.width * camera.height});
  };
  if (lit) take(SPLATBUS_BUFFER_COLOR, GL_COLOR_ATTACHMENT0);
  if (albedo) take(SPLATBUS_BUFFER_ALBEDO, GL_COLOR_ATTACHMENT1);
}

/// Light depth comes alone: where there is no surface it is another value than depth.
void Renderer::Impl::geometry(const LightCamera& of, std::uint32_t buffers, Readback& readback) {
  const splatbus_camera& camera = of.camera;
  Targets& target = targets.get(camera.width, camera.height, false, true);
  const glm::mat4 view = camera_from_world(camera);
  const glm::mat4 clip_from_world = clip_from_camera(camera, of.projection) * view;
  const bool light_depth = (buffers & SPLATBUS_BUFFER_LIGHT_DEPTH) != 0;
  const std::array<bool, 4> wanted{
      (buffers & SPLATBUS_BUFFER_WORLD_POSITION) != 0, (buffers & SPLATBUS_BUFFER_NORMAL) != 0,
      (buffers & SPLATBUS_BUFFER_DEPTH) != 0 || light_depth, (buffers & SPLATBUS_BUFFER_OBJECT_ID) != 0};
  set_draw_buffers(target.geometry, wanted);
  glBindFramebuffer(GL_FRAMEBUFFER, target.geometry.get());
  glViewport(0, 0, static_cast<GLsizei>(camera.width), static_cast<GLsizei>(camera.height));
  constexpr std::array<float, 4> kNothing{};
  const std::array<float, 4> no_surface{light_depth ? camera.far_m : 0, 0, 0, 0};
  constexpr float kFar = 1;
  for (std::size_t i = 0; i < 3; ++i) {
    if (!wanted.at(i)) continue;
    glClearNamedFramebufferfv(target.geometry.get(), GL_COLOR, static_cast<GLint>(i),
                              i == 2 ? no_surface.data() : kNothing.data());
  }
  constexpr std::array<GLuint, 4> kNoObject{};
  if (wanted[3]) glClearNamedFramebufferuiv(target.geometry.get(), GL_COLOR, 3, kNoObject.data());
  glClearNamedFramebufferfv(target.geometry.get(), GL_DEPTH, 0, &kFar);
  const glm::vec4 view_z{view[0][2], view[1][2], view[2][2], view[3][2]};
  const Shown shown = light_depth ? Shown::InLightDepth : Shown::All;
  gpu.draw(clip_from_world, {.kind = ShaderVariant::Kind::Geometry}, shown, [&](const ShaderVariant& variant) {
    const GLuint made = program(variant);
    glProgramUniformMatrix4fv(made, kClipFromWorld, 1, GL_FALSE, glm::value_ptr(clip_from_world));
    if (variant.kind == ShaderVariant::Kind::Geometry) glProgramUniform4fv(made, kViewZ, 1, glm::value_ptr(view_z));
    return made;
  });

  const auto take = [&](splatbus_buffer buffer, GLenum attachment, GLenum format, std::size_t channels,
                        GLenum type = GL_FLOAT) {
    readback.take({.buffer = buffer,
                   .framebuffer = target.geometry.get(),
                   .attachment = attachment,
                   .format = format,
                   .type = type,
                   .width = camera.width,
                   .height = camera.height,
                   .bytes = sizeof(float) * channels * camera.width * camera.height});
  };
  if (wanted[0]) take(SPLATBUS_BUFFER_WORLD_POSITION, GL_COLOR_ATTACHMENT0, GL_RGBA, 4);
  if (wanted[1]) take(SPLATBUS_BUFFER_NORMAL, GL_COLOR_ATTACHMENT1, GL_RGBA, 4);
  if (wanted[2]) {
    take(light_depth ? SPLATBUS_BUFFER_LIGHT_DEPTH : SPLATBUS_BUFFER_DEPTH, GL_COLOR_ATTACHMENT2, GL_RED, 1);
  }
  if (wanted[3]) take(SPLATBUS_BUFFER_OBJECT_ID, GL_COLOR_ATTACHMENT3, GL_RED_INTEGER, 1, GL_UNSIGNED_INT);
}

}  // namespace splatbus::sim
