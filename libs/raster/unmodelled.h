#pragma once

#include "gaussians/light.h"
#include "math/portable.h"

// Which pixels of a picture nothing models yet, as both devices tell it: where the picture shows a surface, and the
// model's opacity is below a bound, and so is its mean over the surface pixels of the pixel's square. A small hole in
// what is modelled is so left to be closed. Pixels without a surface are sky, and must come to be empty.
//
// A far field (kFarFieldFrame) is behind all of the picture, so that its opacity says nothing: there, a square's
// surface is not modelled where what is nearer than the far field hides less than that bound at the square's samples.
namespace splatbus::raster {

inline constexpr int kUnmodelledSide = 8;  ///< pixels of a square's side

/// Pixels of a square at which the opacity of what is nearer than the far field is looked at.
inline constexpr int kUnmodelledSamples = 2;
/// Along x and along y, from the square's corner.
SPLATBUS_PORTABLE int unmodelled_sample(int index) {
  return index == 0 ? 2 : 5;
}
/// Metres from the camera: what is nearer is no far field. Surfaces beyond it never count as modelled where there is
/// one.
inline constexpr float kNearerThanFarField_m = 0.9F * kFarFieldDistance_m;

/// `depth`: metres along z, as the engine has it.
SPLATBUS_PORTABLE bool shows_surface(float depth) {
  return depth > 0 && math::is_finite(depth);
}

}  // namespace splatbus::raster
