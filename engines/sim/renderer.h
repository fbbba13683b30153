#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "gl/context.h"
#include "sdk/splatbus_engine.h"
#include "sim/light_maps.h"
#include "sim/pictures.h"
#include "sim/readback.h"
#include "sim/scene.h"

namespace splatbus::sim {

class DeviceReadback;

struct RendererOptions {
  int supersample = 2;         ///< 1..4; pixels a side that are shaded for one pixel of colour
  int samples = 4;             ///< coverage samples a shaded pixel; the driver's greatest number when that is less.
                               ///< Software takes one where there are many triangles
  int shadow_map_size = 2048;  ///< texels a side, of the sun and directional lights
  int source_map_size = 512;   ///< of a point light's face, and a spot light
  float shadow_softness_m = 0.012F;  ///< radius of the shadow's filter
  float anisotropy = 8;              ///< hardware only
  bool cull = true;                  ///< leaves out what is out of view; pictures are the same without
};

/// The scene at one instant.
struct Instant {
  double time_s = 0;
  splatbus_light light{};  ///< without its sources
  std::vector<splatbus_light_source> sources;
  std::vector<splatbus_object> objects;  ///< that are listed in a frame

  /// With the sources, which are this instant's.
  [[nodiscard]] splatbus_light whole_light() const;
};

/// Draws a scene off screen. Surfaces are Lambertian: linear colour = albedo (E(n) + v s max(0, n.l) / pi), where E is
/// the irradiance over pi of the ambient SH (Ramamoorthi and Hanrahan 2001), s the sun's irradiance and v in [0, 1] its
/// filtered visibility from a shadow map; and so for each other light, with its irradiance as splatbus_light_source has
/// it. Emissive surfaces: colour = albedo. Same scene, time and camera: same bytes.
///
/// Colour and albedo are drawn into multisampled targets of `supersample` times the size and averaged in linear light;
/// position, normal and depth into targets of the very size, so that each value is that of the surface at the exact
/// pixel centre. Only what is asked for is drawn.
///
/// One thread: the one where the context is current.
class Renderer {
 public:
  /// Throws std::runtime_error.
  Renderer(std::shared_ptr<GlContext> context, Scene scene, const RendererOptions& options = {});
  ~Renderer();
  Renderer(const Renderer&) = delete;
  Renderer& operator=(const Renderer&) = delete;

  /// Sets the time. A light's shadow maps are drawn again only when its depth version is another and a lit picture is
  /// asked for.
  void set_time(double time_s);
  /// Puts the sun at an azimuth as of the current time; from there it turns at the lighting's rate. Seen at the next
  /// set_time(), as what the three others change.
  void turn_sun(double azimuth_deg);
  void set_night(bool night);
  void set_sources_on(std::size_t count);
  void show_lamps(bool shown);
  /// Grows whenever set_time() has changed the scene: light or an object has changed, moved, come or gone.
  [[nodiscard]] std::uint64_t scene_version() const;
  [[nodiscard]] const Instant& instant() const;

  /// Draws `buffers` (bits of splatbus_buffer). The result is valid until the next call. Throws std::runtime_error that
  /// names the camera when its size or parameters are out of bounds.
  const Pictures& render(const splatbus_camera& camera, std::uint32_t buffers);

  /// The same of a light's camera, whose projection is its light's.
  const Pictures& render(const LightCamera& camera, std::uint32_t buffers);

  /// The same, with `readback` to take the pictures. Throws also what that throws.
  void render(const splatbus_camera& camera, std::uint32_t buffers, Readback& readback);
  void render(const LightCamera& camera, std::uint32_t buffers, Readback& readback);

  /// Draws small pictures of what cameras usually ask for, so that the first real one waits for no program to be built.
  void warm_up(DeviceReadback* readback);

  /// A light camera of that size over the whole scene, for LIGHT_DEPTH: id is the caller's, pose, scale and range are
  /// the sun's. Constant as long as the sun rests.
  [[nodiscard]] splatbus_camera light_camera(std::uint32_t id, std::uint32_t width, std::uint32_t height) const;

  /// The camera of the depth map that a request of role light asks for; nothing while there is no such map.
  [[nodiscard]] std::optional<LightCamera> light_camera(const splatbus_camera_request& request) const;
  /// Of that map's light: another one whenever the map would show anything else. Nothing while there is no such map.
  [[nodiscard]] std::optional<std::uint64_t> depth_version(const splatbus_camera_request& request) const;

  [[nodiscard]] const Scene& scene() const;
  [[nodiscard]] std::uint64_t shadow_maps_drawn() const;  ///< the sun's
  [[nodiscard]] std::uint64_t source_maps_drawn() const;  ///< of all other lights

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace splatbus::sim
