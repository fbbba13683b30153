#pragma once

#include <cstddef>
#include <vector>

#include "gaussians/model.h"
#include "world/world.h"

namespace splatbus::world {

/// All of a folder's pages one behind the other, in the order of their keys, in host memory.
struct GatheredModel {
  GaussiansBuffer gaussians;           ///< parameters are the averages over time
  std::vector<std::size_t> page_ends;  ///< Gaussians [end before, end) are a page
};

/// Pages that are damaged are left out, as are those that are empty.
[[nodiscard]] GatheredModel gather_model(World& folder);

}  // namespace splatbus::world
