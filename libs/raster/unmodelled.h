#pragma once

#include "math/portable.h"

// Which pixels of a picture nothing models yet, as both devices tell it: where the picture shows a surface, and the
// model's opacity is below a bound, and so is its mean over the surface pixels of the pixel's square. A small hole in
// what is modelled is so left to be closed. Pixels without a surface are sky, and must come to be empty.
namespace splatbus::raster {

inline constexpr int kUnmodelledSide = 8;  ///< pixels of a square's side

/// `depth`: metres along z, as the engine has it.
SPLATBUS_PORTABLE bool shows_surface(float depth) {
  return depth > 0 && math::is_finite(depth);
}

}  // namespace splatbus::raster
