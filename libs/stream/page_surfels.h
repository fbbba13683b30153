#pragma once

#include <cstddef>
#include <glm/glm.hpp>
#include <vector>

#include "stream/replicated_state.h"

namespace splatbus::stream {

/// A few points of a page's surfaces, for who asks what hides what.
struct PageSurfels {
  static constexpr std::size_t kMost = 64;

  std::vector<glm::vec3> points_m;  ///< in the page's frame: means of Gaussians that little shows through
  float radius_m = 0;               ///< discs of it about the points have one to two times the area of the surface
};

/// Of a page as it is held.
[[nodiscard]] PageSurfels surfels_of(const ReplicatedState& state, const HeldPage& page);

}  // namespace splatbus::stream
