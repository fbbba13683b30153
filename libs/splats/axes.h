#pragma once

#include <cstdint>

#include "gaussians/model.h"
#include "splats/splat.h"

namespace splatbus::splats {

/// Which way a file's axes point. Ours and glTF's: x right, y up, z towards who looks along -z; SPZ's too, which calls
/// them RUB. PLY files hold them turned by half a turn about z: x left, y down.
enum class Axes : std::uint8_t {
  OfFormat,  ///< as readers of the format expect; a PLY file that says otherwise is believed
  Keep,      ///< as they are, whatever the format
  Turn,      ///< turned, whatever the format
};

/// Half a turn about z: mean, normal, rotation and SH. Exact, as every number moves or changes its sign; twice is the
/// same rotation again, its quaternion negated.
[[nodiscard]] Splat turned(Splat splat);
/// All of a Radiance model, in place.
void turn(GaussiansBuffer& radiance);

}  // namespace splatbus::splats
