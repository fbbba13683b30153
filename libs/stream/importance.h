#pragma once

#include <span>
#include <vector>

#include "gaussians/camera.h"
#include "gaussians/light.h"
#include "stream/quantised.h"

namespace splatbus::stream {

/// How much of the pictures each Gaussian makes up, an estimate without occlusion: opacity times the area in pixels of
/// its one-sigma ellipse's two largest axes, the largest over the viewers' cameras. Outside all pictures a tenth of
/// what it would be inside: viewers turn. Without cameras the area is in square centimetres.
[[nodiscard]] std::vector<float> picture_share(const QuantisedGaussians& gaussians, const StreamLayout& layout,
                                               std::span<const Camera> cameras, const ObjectTransforms& objects);

}  // namespace splatbus::stream
