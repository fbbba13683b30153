#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <span>
#include <vector>

namespace splatbus::capture_bridge {

/// Chooses at most `budget` points so that what is left covers the surface evenly. Point i stands for `area_m2[i]` of
/// surface; it is kept with probability min(1, area / T), T such that the budget is met, and the choice is systematic
/// along a Morton curve: every stretch of the curve keeps its share, to one point, so that there are neither clumps nor
/// holes. Deterministic, and the same on a device: shares are summed as integers. Returns the kept indices in Morton
/// order (all of them, when they are within the budget).
[[nodiscard]] std::vector<std::uint32_t> thin_to_budget(std::span<const glm::vec3> position,
                                                        std::span<const float> area_m2, std::size_t budget);

}  // namespace splatbus::capture_bridge
