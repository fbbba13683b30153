#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <map>
#include <string>
#include <vector>

#include "capture-bridge/requests.h"
#include "gaussians/light.h"

namespace splatbus::capture_bridge {

struct LightRigOptions {
  std::uint32_t depth_size = 1024;  ///< pixels: maps of the sun and of directional lights
  std::uint32_t source_size = 256;  ///< pixels: a point light's face, a spot light's cone
  std::uint32_t cascades = 3;       ///< most of the sun and of a directional light, with the one of the whole scene
  float extent_m = 40;              ///< side of the finest; each further one is four times as large
};

/// Which depth maps the scene's lights need: of each that casts a shadow one over the whole scene, and cascades about a
/// place where that one is too coarse, or a point light's six faces, or a spot light's one.
class LightRig {
 public:
  /// The whole set. Cascades stay until `centre` has moved an eighth of their side from where they are.
  [[nodiscard]] std::vector<CameraRequest> requests(const LightRigOptions& options, const Light& light,
                                                    const glm::vec3& centre);
  /// A map that has come, of those last asked for. That of the whole scene says how far the scene reaches.
  void saw(std::uint32_t light_id, std::uint32_t light_map, const Camera& camera);

  /// How many maps the light has, where that one, by the camera with that id, is among those last asked for; else 0.
  [[nodiscard]] std::uint32_t maps_with(std::uint32_t light_id, std::uint32_t light_map, std::uint32_t camera_id) const;
  /// Camera ids of the maps last asked for that have never come.
  [[nodiscard]] std::vector<std::uint32_t> missing() const;

 private:
  struct Known {
    std::uint32_t slot = 0;  ///< camera ids are kMaxLightMaps times this, and up
    std::uint32_t maps = 0;
    std::uint32_t seen = 0;  ///< a bit a map, by camera
    bool orthographic = true;
    float scene_m = 0;              ///< side of its map of the whole scene; 0: not known
    std::vector<glm::vec3> centre;  ///< of each finer cascade
  };
  [[nodiscard]] static std::uint32_t camera_of(const Known& light, std::uint32_t light_map);
  void forget_others(const Light& light);
  Known& known(std::uint32_t light_id);
  void place_cascades(const LightRigOptions& options, const glm::vec3& centre, Known& light) const;

  std::map<std::uint32_t, Known> of_light_;
};

/// Why a depth map that the engine sent is of no use: no such light, one without shadow, or a camera that is not the
/// light's. Empty when it is of use.
[[nodiscard]] std::string fault_of(const Light& light, std::uint32_t light_id, std::uint32_t light_map,
                                   const Camera& camera);

}  // namespace splatbus::capture_bridge
