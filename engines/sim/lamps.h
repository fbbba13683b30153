#pragma once

#include <cstddef>

#include "sim/scene.h"

namespace splatbus::sim {

inline constexpr std::size_t kLamps = 16;

/// Adds lamps over the toys: point lights 1 to kLamps on smooth closed paths, each in a small ball, "lamp 1", that
/// shines and does not cast its shadow. A lamp exists while its light does, see Lighting::sources_on.
void add_lamps(Scene& scene);

}  // namespace splatbus::sim
