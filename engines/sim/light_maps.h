#pragma once

#include <glm/glm.hpp>
#include <optional>

#include "sdk/splatbus_engine.h"
#include "sim/mesh.h"
#include "sim/projection.h"

namespace splatbus::sim {

/// A camera of role light, as SDK and requests have it: id and size are the caller's.
struct LightCamera {
  splatbus_camera camera;
  Projection projection;
};

/// What lights a scene, and where it is.
struct LitScene {
  const splatbus_light& light;  ///< with its sources
  const Bounds& bounds;         ///< of all that depth maps show
};

/// The depth map `request.light_map` of the light `request.light_id`; nothing while that light is not there, casts no
/// shadow or has no such map.
[[nodiscard]] std::optional<LightCamera> light_camera(const splatbus_camera_request& request, const LitScene& scene);

/// Orthographic along the light, over a square of `extent_m` about `centre` in the light's plane; near and far take in
/// all of `scene`. Moves by `step_texels` at once, so that while the light rests a texel's border stays where it is:
/// the square's middle is within half a step of `centre`.
[[nodiscard]] splatbus_camera cascade_camera(const glm::vec3& centre, float extent_m, const glm::vec3& to_light,
                                             const Bounds& scene, std::uint32_t width, std::uint32_t height,
                                             float step_texels = 1);

/// Face 0 to 5 of a point light: +x, -x, +y, -y, +z, -z. 90 degrees and two texels more on every side, for filters.
[[nodiscard]] splatbus_camera point_face_camera(const splatbus_light_source& source, std::uint32_t face,
                                                std::uint32_t width, std::uint32_t height);

/// A spot light's cone, and two texels more.
[[nodiscard]] splatbus_camera spot_camera(const splatbus_light_source& source, std::uint32_t width,
                                          std::uint32_t height);

}  // namespace splatbus::sim
