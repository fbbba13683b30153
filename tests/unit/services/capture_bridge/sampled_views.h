#pragma once

#include <cmath>
#include <limits>
#include <vector>

#include "analytic_scene.h"
#include "capture-bridge/pixel_views.h"
#include "capture-bridge/sampling.h"
#include "capture-bridge/surface.h"

namespace splatbus::capture_bridge::test {

inline SampledRound sample(const std::vector<InputView>& views, const ObjectTransforms& round_objects,
                           const SamplingOptions& options) {
  std::vector<const InputView*> pointers;
  for (const InputView& view : views) pointers.push_back(&view);
  return sample_views(pointers, round_objects, options);
}

/// One view's surface, taken apart.
struct ViewSurface {
  RoundSurface pixels;
  std::vector<float> footprint_m;
  std::vector<bool> edge;
};

inline ViewSurface analyse_surface(const InputView& view) {
  const InputView* const pointer = &view;
  ViewSurface surface{.pixels = analyse_surfaces(pixel_views({&pointer, 1}, view.objects), {})};
  for (const Texel& texel : surface.pixels.texels) {
    surface.footprint_m.push_back(std::abs(texel.footprint_m));
    surface.edge.push_back(texel.footprint_m < 0);
  }
  return surface;
}

/// No budget, and one camera a surface.
inline SamplingOptions unlimited() {
  return {.budget = 10'000'000, .cameras_per_surface = 1};
}

/// Nearest kept sample with a similar normal.
inline float nearest_sample(const SampleSet& samples, const glm::vec3& position, const glm::vec3& normal,
                            std::size_t* which) {
  float nearest = std::numeric_limits<float>::max();
  for (std::size_t i = 0; i < samples.size(); ++i) {
    if (glm::dot(samples.normal[i], normal) < 0.5F) continue;
    const float distance = glm::distance(samples.position[i], position);
    if (distance >= nearest) continue;
    nearest = distance;
    *which = i;
  }
  return nearest;
}

}  // namespace splatbus::capture_bridge::test
