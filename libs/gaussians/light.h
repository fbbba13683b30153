#pragma once

#include <array>
#include <cstdint>
#include <glm/glm.hpp>
#include <map>

#include "gaussians/camera.h"

namespace splatbus {

/// Real SH basis of degree 2, order l=0 | l=1: m=-1,0,1 | l=2: m=-2..2, signs as in 3DGS (Kerbl et al. 2023), so that
/// Y1 = (-C1 y, C1 z, -C1 x). docs/protocol.md lists all of them.
using Sh9 = std::array<float, 9>;

/// Light of one instant, in world space and linear radiometric units.
struct Light {
  std::uint64_t generation = 0;
  std::array<glm::vec3, 9> ambient_sh{};  ///< incident radiance, RGB a coefficient
  glm::vec3 sun_direction{0, 1, 0};       ///< unit, from the scene towards the sun
  glm::vec3 sun_irradiance{0};            ///< on a surface that faces the sun
  glm::vec3 background{0};                ///< linear colour behind everything
  bool operator==(const Light&) const = default;
};

/// Irradiance over pi is what a white Lambertian surface with normal n reflects (Ramamoorthi and Hanrahan 2001):
/// sum_l A_l/pi L_l Y_l(n), clamped-cosine factors A_l/pi = 1, 2/3, 1/4.
[[nodiscard]] glm::vec3 ambient_reflected(const Light& light, const glm::vec3& normal_world);

/// The light as seen in an object's frame: SH and sun direction rotated by object_from_world.
[[nodiscard]] Light rotate_light(const Light& light, const glm::quat& object_from_world);

[[nodiscard]] Sh9 sh9_basis(const glm::vec3& unit_direction);
/// SH coefficients of f(R^-1 d), given those of f(d), for each colour channel.
[[nodiscard]] std::array<glm::vec3, 9> rotate_sh9(const std::array<glm::vec3, 9>& coefficients,
                                                  const glm::quat& rotation);

/// Transforms of the objects that can move; an id that is not here has local frame = world.
using ObjectTransforms = std::map<std::uint32_t, Rigid>;  // world_from_object

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
