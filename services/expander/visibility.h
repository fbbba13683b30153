#pragma once

#include <vector>

#include "expander/input_samples.h"

namespace splatbus::expander {

struct VisibilityOptions {
  float min_cosine = 0.15F;       ///< between normal and direction to the camera
  float depth_tolerance = 0.02F;  ///< of the depth
};

/// For every sample, whether the camera that took it really sees it: from a good enough angle, and with the depth that
/// the camera's depth map has there. Samples of moving objects skip the depth: they may have moved since.
[[nodiscard]] std::vector<bool> seen_samples(const InputSamples& samples, const VisibilityOptions& options);

}  // namespace splatbus::expander
