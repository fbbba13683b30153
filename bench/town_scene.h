#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "gaussians/model.h"

namespace splatbus::bench {

/// The built-in engine's town as a model that nobody trained: disks on its still surfaces with their albedo, static and
/// in the light (Transfer), as dense as a walk through it would leave them: spaced by the distance to the walk.
struct TownScene {
  GaussiansBuffer model;     ///< along a Morton curve
  std::vector<Camera> walk;  ///< a viewer's, evenly along the walk, looking ahead
  SceneState scene;
};

/// About so many Gaussians. The same for the same arguments.
[[nodiscard]] TownScene make_town_scene(std::size_t gaussians, std::uint32_t seed, std::size_t cameras,
                                        std::uint32_t width, std::uint32_t height);

}  // namespace splatbus::bench
