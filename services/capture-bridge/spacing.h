#pragma once

#include <glm/glm.hpp>
#include <span>
#include <vector>

namespace splatbus::capture_bridge {

/// Metres between each point and its neighbours on the same surface: the mean distance to the four nearest whose
/// normals are within 60 degrees. On a square grid that is the grid's step. A point with fewer than two such neighbours
/// keeps `fallback_m`; no spacing is larger than four times its fallback (a lone sample far from everything). Quick
/// when the points come in Morton order. Uses all TBB workers.
[[nodiscard]] std::vector<float> estimate_spacing(std::span<const glm::vec3> position,
                                                  std::span<const glm::vec3> normal, std::span<const float> fallback_m);

}  // namespace splatbus::capture_bridge
