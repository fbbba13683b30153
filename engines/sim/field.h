#pragma once

#include <cstdint>

#include "sim/scene.h"

namespace splatbus::sim {

/// A field of 200 m (object 1, y = 0) about the origin with some 200 posts of 10 x 10 cm and boxes of 0.4 to 2.5 m,
/// which `seed` places; more of them near the origin. "near post" stands at (1, 0, 0) and is 1.5 m high.
[[nodiscard]] Scene make_field(std::uint32_t seed);

}  // namespace splatbus::sim
