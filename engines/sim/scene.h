#pragma once

#include <cstdint>
#include <functional>
#include <glm/glm.hpp>
#include <glm/gtc/quaternion.hpp>
#include <optional>
#include <string>
#include <vector>

#include "sdk/splatbus_engine.h"
#include "sim/mesh.h"

namespace splatbus::sim {

inline constexpr glm::vec3 kUp{0, 1, 0};  ///< of every scene

/// RGBA8, row 0 on top, linear light under the sRGB curve.
struct Image {
  std::uint32_t width = 0, height = 0;
  std::vector<std::uint8_t> rgba;
};

struct Material {
  int image = -1;           ///< index into Scene::images, -1: none
  glm::vec3 base_color{1};  ///< linear diffuse albedo, times the image
  float alpha_cutoff = 0;   ///< texels below are holes; 0: none
  bool double_sided = false;
  bool repeat = true;  ///< the texture repeats; else its edge goes on
};

struct Part {
  Mesh mesh;  ///< in the object's frame
  int material = 0;
};

/// a_from_b: p_a = rotation * (scale * p_b) + translation.
struct Pose {
  glm::quat rotation{1, 0, 0, 0};
  glm::vec3 translation{0};
  float scale = 1;
  bool operator==(const Pose&) const = default;
};
/// a_from_b * b_from_c.
[[nodiscard]] Pose operator*(const Pose& a_from_b, const Pose& b_from_c);

struct Object {
  std::uint32_t id = 0;  ///< unique, from 1
  std::string name;
  std::vector<Part> parts;
  glm::mat4 world_from_object{1};  ///< of an object that rests
  /// world_from_object at a time in seconds, or nothing while the object does not exist. Empty: it rests for ever.
  std::function<std::optional<Pose>(double)> motion;
  Bounds motion_origins;       ///< where the motion takes the object's origin, at whatever time
  float greatest_scale = 1;    ///< of the motion
  std::uint32_t light_id = 0;  ///< of a lamp: it exists only while this light does; 0: it is none
  bool casts_shadow = true;
  bool emissive = false;  ///< it shines with its albedo, and is not lit
  bool modelled = true;   ///< SPLATBUS_OBJECT_NOT_MODELLED where false
  bool enclosed = false;  ///< other objects hide it from most places: drawn after them, and only where it may be seen

  /// Whether the depth maps that are handed out show it. A lamp's glass is neither a thing that hides its light nor one
  /// on which light falls.
  [[nodiscard]] bool in_light_depth() const { return casts_shadow || !emissive; }
};

/// A light besides the sun.
struct LightSource {
  std::uint32_t id = 0;  ///< unique, from 1
  /// The light at a time in seconds, or nothing while there is none. Its id and depth_version do not count. A spot's
  /// cone is at most 80 degrees from its axis, so that one depth map holds it.
  std::function<std::optional<splatbus_light_source>(double)> at;
};

/// The sun's way, and all other light of a scene. Linear radiometric units.
struct Lighting {
  double sun_azimuth_deg = 40;  ///< about world y, from +x towards +z
  double sun_zenith_deg = 45;
  double sun_rate_deg_s = 0;  ///< azimuth's
  glm::vec3 sun_irradiance{2.75F, 2.6F, 2.3F};
  splatbus_light ambient = sky();  ///< ambient_sh and background count
  bool night = false;              ///< no sun, and a faint sky
  bool clouds = false;             ///< behind everything a sky (sky.h), not the plain background
  std::vector<LightSource> sources;
  std::size_t sources_on = SPLATBUS_MAX_LIGHTS;  ///< so many of them, from the first
  bool lamps_shown = true;                       ///< else they shine and their lamps are not there

  /// Without the sources, and with no depth version.
  [[nodiscard]] splatbus_light at(double time_s) const;
  /// By ascending id, with no depth version.
  [[nodiscard]] std::vector<splatbus_light_source> sources_at(double time_s) const;
  static splatbus_light sky();
};

struct Scene {
  std::vector<Object> objects;
  std::vector<Material> materials;
  std::vector<Image> images;
  Lighting lighting;

  /// Appends an object of one part under the next free id. The reference is good until the next one is added.
  Object& add(std::string name, Mesh mesh, Image image, const glm::mat4& world_from_object = glm::mat4(1));

  /// The same of a material that is there, by its index.
  Object& add(std::string name, Mesh mesh, int material, const glm::mat4& world_from_object = glm::mat4(1));

  /// World bounds of what depth maps show, over the whole way of what moves.
  [[nodiscard]] Bounds bounds(bool shadow_casters_only) const;
  [[nodiscard]] std::size_t triangle_count() const;
};

[[nodiscard]] glm::mat4 matrix(const Pose& world_from_object);

}  // namespace splatbus::sim
