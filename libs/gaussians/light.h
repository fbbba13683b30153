#pragma once

#include <array>
#include <cstdint>
#include <glm/glm.hpp>
#include <map>
#include <vector>

#include "gaussians/camera.h"
#include "gaussians/frames.h"

namespace splatbus {

/// Real SH basis of degree 2, order l=0 | l=1: m=-1,0,1 | l=2: m=-2..2, signs as in 3DGS (Kerbl et al. 2023), so that
/// Y1 = (-C1 y, C1 z, -C1 x). docs/protocol.md lists all of them.
using Sh9 = std::array<float, 9>;

enum class LightKind : std::uint8_t { Directional, Point, Spot };

/// A light besides the sun, in world space and linear radiometric units.
struct LightSource {
  std::uint32_t id = 0;  ///< not 0, stays with the light
  LightKind kind = LightKind::Point;
  bool casts_shadow = true;         ///< it has depth maps; another one shines through everything
  glm::vec3 position{0};            ///< metres: Point, Spot
  glm::vec3 direction{0, 1, 0};     ///< unit: Directional, towards the light; Spot, its axis away from it
  glm::vec3 intensity{0};           ///< irradiance on a surface that faces it: Directional; others, at 1 m
  float range_m = 10;               ///< Point, Spot
  float cos_inner = 1;              ///< Spot: full light within,
  float cos_outer = 0;              ///< none without
  std::uint64_t depth_version = 0;  ///< changes whenever its depth maps would show anything else
  bool operator==(const LightSource&) const = default;
};

/// Of one scene, besides the sun.
inline constexpr std::size_t kMaxLightSources = 32;
/// Depth maps of one light: cascades, or a point light's six faces.
inline constexpr std::uint32_t kMaxLightMaps = 8;

/// What arrives of a source at a point.
struct Incident {
  glm::vec3 to_light{0, 1, 0};  ///< unit
  glm::vec3 irradiance{0};      ///< on a surface that faces the light
};
/// Inverse-square with a window of range_m (Karis 2013, "Real Shading in Unreal Engine 4", eq. 9); a spot's cone as
/// KHR_lights_punctual of glTF has it. schemas/common.fbs writes it out.
[[nodiscard]] Incident incident(const LightSource& source, const glm::vec3& point);

/// Light of one instant, in world space and linear radiometric units.
struct Light {
  std::uint64_t generation = 0;
  std::array<glm::vec3, 9> ambient_sh{};  ///< incident radiance, RGB a coefficient
  glm::vec3 sun_direction{0, 1, 0};       ///< unit, from the scene towards the sun
  glm::vec3 sun_irradiance{0};            ///< on a surface that faces the sun
  glm::vec3 background{0};                ///< linear colour behind everything
  std::vector<LightSource> sources;       ///< besides the sun, by ascending id
  std::uint64_t sun_depth_version = 0;    ///< as LightSource's
  bool operator==(const Light&) const = default;
};

/// Irradiance over pi is what a white Lambertian surface with normal n reflects (Ramamoorthi and Hanrahan 2001):
/// sum_l A_l/pi L_l Y_l(n), clamped-cosine factors A_l/pi = 1, 2/3, 1/4.
[[nodiscard]] glm::vec3 ambient_reflected(const Light& light, const glm::vec3& normal_world);

[[nodiscard]] Sh9 sh9_basis(const glm::vec3& unit_direction);
/// SH coefficients of f(R^-1 d), given those of f(d), for each colour channel.
[[nodiscard]] std::array<glm::vec3, 9> rotate_sh9(const std::array<glm::vec3, 9>& coefficients,
                                                  const glm::quat& rotation);

/// world_from_object: p_world = rigid.rotation * (scale * p_object) + rigid.translation.
struct ObjectTransform {
  Rigid rigid;
  float scale = 1;        ///< above 0, the same along all axes
  bool emissive = false;  ///< its surfaces shine with their albedo and are not lit
  bool modelled = true;   ///< otherwise no Gaussians are made of it, and pictures do not train where it shows

  ObjectTransform() = default;
  ObjectTransform(const Rigid& world_from_object) : rigid(world_from_object) {}  // NOLINT(google-explicit-constructor)
  bool operator==(const ObjectTransform&) const = default;
};
[[nodiscard]] glm::vec3 operator*(const ObjectTransform& world_from_object, const glm::vec3& point_object);
/// The other way.
[[nodiscard]] glm::vec3 object_point(const ObjectTransform& world_from_object, const glm::vec3& point_world);

/// The light as an object's Gaussians see it: in its frame, where lengths are 1 / scale of the world's; of an emissive
/// object a light that makes every surface's colour its albedo.
[[nodiscard]] Light light_in_object(const Light& light, const ObjectTransform& world_from_object);

/// Gaussians of the far field (kFarFieldFrame) lie on a sphere of this radius about this point, which is far from where
/// an object's own points are, and emit what is seen.
inline constexpr float kFarFieldRadius = 4;
inline constexpr glm::vec3 kFarFieldCentre{0, -1024, 0};
/// Metres from any camera to the far field: everything else is nearer.
inline constexpr float kFarFieldDistance_m = 1000;
/// As scenes list it, which is how those that do not draw see it.
[[nodiscard]] ObjectTransform far_field();
/// Where an object is for a camera at `eye_world`: the far field goes with it, and nothing else does.
[[nodiscard]] ObjectTransform seen_from(const glm::vec3& eye_world, std::uint32_t object_id,
                                        const ObjectTransform& world_from_object);

/// The objects that can move and exist; an id that is not here has local frame = world.
using ObjectTransforms = std::map<std::uint32_t, ObjectTransform>;

/// Of the rows of visibility under that light, ascending: 0, the sun, then every source's.
[[nodiscard]] std::vector<std::uint32_t> light_ids(const Light& light);

/// What a render needs besides Gaussians and camera.
struct SceneState {
  Light light;
  ObjectTransforms objects;
  std::uint64_t version = 0;  ///< the capture-bridge's number of this light and these objects
};

/// The sRGB transfer function (IEC 61966-2-1), on [0, 1].
[[nodiscard]] float srgb_from_linear(float linear);
[[nodiscard]] float linear_from_srgb(float srgb);

}  // namespace splatbus
