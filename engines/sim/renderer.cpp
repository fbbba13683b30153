#include "sim/renderer.h"

#include <algorithm>
#include <array>
#include <glm/gtc/type_ptr.hpp>
#include <map>
#include <span>
#include <stdexcept>

#include "sim/camera_check.h"
#include "sim/depth_versions.h"
#include "sim/gl_objects.h"
#include "sim/gpu_scene.h"
#include "sim/lit_shading.h"
#include "sim/projection.h"
#include "sim/shaders.h"
#include "sim/targets.h"

namespace splatbus::sim {
namespace {

constexpr std::uint32_t kShadeBuffers = SPLATBUS_BUFFER_COLOR | SPLATBUS_BUFFER_ALBEDO;
constexpr std::uint32_t kGeometryBuffers =
    SPLATBUS_BUFFER_WORLD_POSITION | SPLATBUS_BUFFER_NORMAL | SPLATBUS_BUFFER_DEPTH | SPLATBUS_BUFFER_OBJECT_ID;

bool same_light(const Instant& a, const Instant& b) {
  const auto values = [](const splatbus_light& light) {
    const float *d = light.sun_direction, *s = light.sun_irradiance;
    return std::array{d[0], d[1], d[2], s[0], s[1], s[2]};
  };
  const auto same = [](const splatbus_light_source& x, const splatbus_light_source& y) {
    return x.id == y.id && x.depth_version == y.depth_version && x.cos_inner == y.cos_inner &&
           std::ranges::equal(x.intensity, y.intensity);
  };
  return values(a.light) == values(b.light) && std::ranges::equal(a.sources, b.sources, same);
}

}  // namespace

struct Renderer::Impl {
  Impl(std::shared_ptr<GlContext> gl_context, Scene the_scene, const RendererOptions& the_options)
      : context(std::move(gl_context)),
        scene(std::move(the_scene)),
        options(the_options),
        gpu(scene, options.anisotropy),
        targets(options.supersample, options.samples),
        lighting({options.shadow_map_size, options.source_map_size, options.shadow_softness_m}, scene),
        bounds(scene.bounds(false)) {}

  std::shared_ptr<GlContext> context;
  Scene scene;
  RendererOptions options;
  GpuScene gpu;
  TargetCache targets;
  LitShading lighting;
  Bounds bounds;
  std::map<ShaderVariant, GlProgram> programs;
  std::map<std::pair<bool, bool>, GlProgram> resolve_programs;
  GlVertexArray no_vertices = make_vertex_array();
  Instant instant;
  std::uint64_t scene_version = 0;
  DepthVersions depth_versions;
  Pictures pictures;

  GLuint program(const ShaderVariant& variant) {
    GlProgram& made = programs[variant];
    if (!made) made = build_program(variant);
    return made.get();
  }

  void shade(const LightCamera& view, bool lit, bool albedo, Readback& readback);
  void geometry(const LightCamera& view, std::uint32_t buffers, Readback& readback);
};

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
  const float* sky = instant.light.background;
  const std::array<float, 4> background{sky[0], sky[1], sky[2], 0};
  constexpr std::array<float, 4> kNothing{};
  constexpr float kFar = 1;
  if (lit) glClearNamedFramebufferfv(target.shade.get(), GL_COLOR, 0, background.data());
  if (albedo) glClearNamedFramebufferfv(target.shade.get(), GL_COLOR, 1, kNothing.data());
  glClearNamedFramebufferfv(target.shade.get(), GL_DEPTH, 0, &kFar);

  std::map<GLuint, bool> prepared;
  gpu.draw(clip_from_world, variant_of_all, Shown::All, [&](const ShaderVariant& variant) {
    const GLuint made = program(variant);
    if (std::exchange(prepared[made], true)) return made;
    glProgramUniformMatrix4fv(made, kClipFromWorld, 1, GL_FALSE, glm::value_ptr(clip_from_world));
    if (lit && !variant.emissive) lighting.bind(made, light);
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
    glProgramUniform4fv(made, kViewZ, 1, glm::value_ptr(view_z));
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

Renderer::Renderer(std::shared_ptr<GlContext> context, Scene scene, const RendererOptions& options) {
  RendererOptions bounded = options;
  GLint samples = 1;
  glGetIntegerv(GL_MAX_COLOR_TEXTURE_SAMPLES, &samples);
  bounded.samples = std::clamp(options.samples, 1, samples);
  bounded.supersample = std::clamp(options.supersample, 1, 4);
  // llvmpipe walks a grazing texel footprint for seconds; the supersamples spread along it anyway.
  if (context->is_software()) bounded.anisotropy = 1;
  impl_ = std::make_unique<Impl>(std::move(context), std::move(scene), bounded);
  glEnable(GL_DEPTH_TEST);
  glEnable(GL_MULTISAMPLE);
  glFrontFace(GL_CW);  // pictures are drawn with their rows downwards
  glPixelStorei(GL_PACK_ALIGNMENT, 1);
  set_time(0);
}

Renderer::~Renderer() = default;

void Renderer::set_time(double time_s) {
  Instant next{.time_s = time_s,
               .light = impl_->scene.lighting.at(time_s),
               .sources = impl_->scene.lighting.sources_at(time_s),
               .objects = {}};
  const ObjectChanges changes = impl_->gpu.set_time(impl_->scene, time_s, next.sources);
  impl_->depth_versions.update(next.light, next.sources, changes.moved);
  next.objects = impl_->gpu.listed();
  const bool relit = !same_light(next, impl_->instant);
  impl_->instant = std::move(next);
  if (changes.any || relit || impl_->scene_version == 0) ++impl_->scene_version;
}

void Renderer::turn_sun(double azimuth_deg) {
  Lighting& lighting = impl_->scene.lighting;
  lighting.sun_azimuth_deg = azimuth_deg - lighting.sun_rate_deg_s * impl_->instant.time_s;
}

void Renderer::set_night(bool night) {
  impl_->scene.lighting.night = night;
}

void Renderer::set_sources_on(std::size_t count) {
  impl_->scene.lighting.sources_on = count;
}

std::uint64_t Renderer::scene_version() const {
  return impl_->scene_version;
}
const Instant& Renderer::instant() const {
  return impl_->instant;
}
const Scene& Renderer::scene() const {
  return impl_->scene;
}
std::uint64_t Renderer::shadow_maps_drawn() const {
  return impl_->lighting.sun_maps_drawn();
}
std::uint64_t Renderer::source_maps_drawn() const {
  return impl_->lighting.source_maps_drawn();
}

const Pictures& Renderer::render(const splatbus_camera& camera, std::uint32_t buffers) {
  return render(LightCamera{camera, projection_by_role(camera)}, buffers);
}

const Pictures& Renderer::render(const LightCamera& camera, std::uint32_t buffers) {
  HostReadback readback(impl_->pictures);
  render(camera, buffers, readback);
  return impl_->pictures;
}

void Renderer::render(const splatbus_camera& camera, std::uint32_t buffers, Readback& readback) {
  render(LightCamera{camera, projection_by_role(camera)}, buffers, readback);
}

void Renderer::render(const LightCamera& view, std::uint32_t buffers, Readback& readback) {
  if (const std::string wrong = camera_problem(view.camera); !wrong.empty()) throw std::runtime_error(wrong);
  readback.begin(view.camera.width, view.camera.height);
  if ((buffers & kShadeBuffers) != 0) {
    impl_->shade(view, (buffers & SPLATBUS_BUFFER_COLOR) != 0, (buffers & SPLATBUS_BUFFER_ALBEDO) != 0, readback);
  }
  if ((buffers & kGeometryBuffers) != 0) impl_->geometry(view, buffers & kGeometryBuffers, readback);
  if ((buffers & SPLATBUS_BUFFER_LIGHT_DEPTH) != 0) impl_->geometry(view, SPLATBUS_BUFFER_LIGHT_DEPTH, readback);
}

void Renderer::warm_up(Readback* readback) {
  constexpr std::uint32_t kSize = 64;
  HostReadback host(impl_->pictures);
  // The light's camera has every object in view, and so every program in use.
  const splatbus_camera camera = light_camera(0, kSize, kSize);
  for (const std::uint32_t buffers : {kShadeBuffers | kGeometryBuffers, std::uint32_t{SPLATBUS_BUFFER_COLOR}}) {
    render(camera, buffers | SPLATBUS_BUFFER_LIGHT_DEPTH, readback != nullptr ? *readback : host);
  }
}

splatbus_camera Renderer::light_camera(std::uint32_t id, std::uint32_t width, std::uint32_t height) const {
  const float* sun = impl_->instant.light.sun_direction;
  splatbus_camera camera = fit_light_camera(impl_->bounds, {sun[0], sun[1], sun[2]}, width, height);
  camera.id = id;
  return camera;
}

std::optional<LightCamera> Renderer::light_camera(const splatbus_camera_request& request) const {
  const splatbus_light light = impl_->instant.whole_light();
  return sim::light_camera(request, {light, impl_->bounds});
}

std::optional<std::uint64_t> Renderer::depth_version(const splatbus_camera_request& request) const {
  if (!light_camera(request)) return std::nullopt;
  const Instant& instant = impl_->instant;
  if (request.light_id == 0) return instant.light.sun_depth_version;
  return std::ranges::find(instant.sources, request.light_id, &splatbus_light_source::id)->depth_version;
}

splatbus_light Instant::whole_light() const {
  splatbus_light result = light;
  result.sources = sources.data();
  result.source_count = sources.size();
  return result;
}

}  // namespace splatbus::sim
