#include "sim/renderer.h"

#include <algorithm>
#include <array>
#include <stdexcept>
#include <utility>

#include "sim/camera_check.h"
#include "sim/device_readback.h"
#include "sim/projection.h"
#include "sim/renderer_impl.h"

namespace splatbus::sim {
namespace {

constexpr std::uint32_t kShadeBuffers = SPLATBUS_BUFFER_COLOR | SPLATBUS_BUFFER_ALBEDO;
constexpr std::uint32_t kGeometryBuffers =
    SPLATBUS_BUFFER_WORLD_POSITION | SPLATBUS_BUFFER_NORMAL | SPLATBUS_BUFFER_DEPTH | SPLATBUS_BUFFER_OBJECT_ID;

/// As splatbus_buffer lays them out.
std::size_t bytes_a_pixel(std::uint32_t buffers) {
  constexpr std::array kBytes{std::pair{SPLATBUS_BUFFER_COLOR, 4U},      std::pair{SPLATBUS_BUFFER_WORLD_POSITION, 16U},
                              std::pair{SPLATBUS_BUFFER_NORMAL, 16U},    std::pair{SPLATBUS_BUFFER_OBJECT_ID, 4U},
                              std::pair{SPLATBUS_BUFFER_ALBEDO, 4U},     std::pair{SPLATBUS_BUFFER_DEPTH, 4U},
                              std::pair{SPLATBUS_BUFFER_LIGHT_DEPTH, 4U}};
  std::size_t bytes = 0;
  for (const auto& [buffer, of_one] : kBytes) bytes += (buffers & buffer) != 0 ? of_one : 0;
  return bytes;
}

/// Beyond them a picture of software costs what its triangles do, not its pixels.
constexpr std::size_t kManyTriangles = 200'000;

bool same_light(const Instant& a, const Instant& b) {
  const auto values = [](const splatbus_light& light) {
    const float *d = light.sun_direction, *s = light.sun_irradiance;
    return std::array{d[0], d[1], d[2], s[0], s[1], s[2]};
  };
  const auto same = [](const splatbus_light_source& x, const splatbus_light_source& y) {
    return x.id == y.id && x.depth_version == y.depth_version && x.cos_inner == y.cos_inner &&
           std::ranges::equal(x.intensity, y.intensity);
  };
  return values(a.light) == values(b.light) && std::ranges::equal(a.light.ambient_sh, b.light.ambient_sh) &&
         std::ranges::equal(a.light.background, b.light.background) && std::ranges::equal(a.sources, b.sources, same);
}

}  // namespace

Renderer::Renderer(std::shared_ptr<GlContext> context, Scene scene, const RendererOptions& options) {
  RendererOptions bounded = options;
  GLint samples = 1;
  glGetIntegerv(GL_MAX_COLOR_TEXTURE_SAMPLES, &samples);
  bounded.samples = std::clamp(options.samples, 1, samples);
  bounded.supersample = std::clamp(options.supersample, 1, 4);
  if (context->is_software()) {
    // llvmpipe walks a grazing texel footprint for seconds; the supersamples spread along it anyway.
    bounded.anisotropy = 1;
    // And of a multisampled target it rasterises even triangles that cover no sample: twice the time of a picture.
    if (scene.triangle_count() > kManyTriangles) bounded.samples = 1;
  }
  impl_ = std::make_unique<Impl>(std::move(context), std::move(scene), bounded);
  glEnable(GL_DEPTH_TEST);
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

void Renderer::show_lamps(bool shown) {
  impl_->scene.lighting.lamps_shown = shown;
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
  readback.begin(view.camera.width, view.camera.height,
                 std::size_t{view.camera.width} * view.camera.height * bytes_a_pixel(buffers));
  if ((buffers & kShadeBuffers) != 0) {
    impl_->shade(view, (buffers & SPLATBUS_BUFFER_COLOR) != 0, (buffers & SPLATBUS_BUFFER_ALBEDO) != 0, readback);
  }
  if ((buffers & kGeometryBuffers) != 0) impl_->geometry(view, buffers & kGeometryBuffers, readback);
  if ((buffers & SPLATBUS_BUFFER_LIGHT_DEPTH) != 0) impl_->geometry(view, SPLATBUS_BUFFER_LIGHT_DEPTH, readback);
}

void Renderer::warm_up(DeviceReadback* readback) {
  constexpr std::uint32_t kSize = 64;
  HostReadback host(impl_->pictures);
  const auto draw = [&] {
    // The light's camera has every object in view, and so every program in use.
    const splatbus_camera camera = light_camera(0, kSize, kSize);
    for (const std::uint32_t buffers : {kShadeBuffers | kGeometryBuffers, std::uint32_t{SPLATBUS_BUFFER_COLOR}}) {
      render(camera, buffers | SPLATBUS_BUFFER_LIGHT_DEPTH,
             readback != nullptr ? static_cast<Readback&>(*readback) : host);
      if (readback != nullptr) static_cast<void>(readback->finish());
    }
  };
  draw();
  Lighting& lighting = impl_->scene.lighting;
  if (lighting.sources.empty() || lighting.sources_on > 0) return;
  // Lights may be turned on later: their programs are others.
  const double time_s = impl_->instant.time_s;
  lighting.sources_on = 1;
  set_time(time_s);
  draw();
  lighting.sources_on = 0;
  set_time(time_s);
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
