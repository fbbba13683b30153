#pragma once

#include <cstdint>

#include "sim/scene.h"

namespace splatbus::sim {

/// The default scene, "toys on a floor": a patterned floor of 5 m (object 1) and some twenty textured toys of 0.15 to
/// 0.9 m within 1.9 m of the origin, standing on y = 0. `seed` turns and shifts the toys a little and shuffles grain
/// and tones. With `dynamics` the living toys (living_toys.h) are there too.
[[nodiscard]] Scene make_toys(std::uint32_t seed, bool dynamics);

}  // namespace splatbus::sim
