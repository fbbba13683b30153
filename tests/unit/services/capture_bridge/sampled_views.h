#pragma once

#include <cmath>
#include <limits>
#include <vector>

#include "analytic_scene.h"
#include "capture-bridge/sampler.h"

namespace splatbus::capture_bridge::test {

/// A round's samples in vectors of their own.
struct SampleSet {
  std::vector<glm::vec3> position, normal, albedo, color;
  std::vector<float> spacing_m;
  std::vector<std::uint32_t> object_id, camera, pixel;  ///< pixel: in its camera's picture

  [[nodiscard]] std::size_t size() const { return position.size(); }
};

struct SampledRound : RoundCounts {
  SampleSet samples;
};

inline SampledRound sample(const std::vector<InputView>& views, const ObjectTransforms& round_objects,
                           const SamplingOptions& options) {
  std::vector<const InputView*> pointers;
  for (const InputView& view : views) pointers.push_back(&view);
  Sampler sampler(Device::Cpu);
  const RoundSamples from = sampler.sample(pointers, round_objects, options);
  SampledRound round{from, {}};
  SampleSet& to = round.samples;
  const auto vectors = [&](const float* array, std::vector<glm::vec3>& out) {
    const auto* const first = reinterpret_cast<const glm::vec3*>(array);
    out.assign(first, first + from.size);
  };
  vectors(from.position, to.position);
  vectors(from.normal, to.normal);
  vectors(from.albedo, to.albedo);
  vectors(from.color, to.color);
  to.spacing_m.assign(from.spacing_m, from.spacing_m + from.size);
  to.object_id.assign(from.object_id, from.object_id + from.size);
  for (std::size_t i = 0; i < from.size; ++i) {
    const auto view_pixels = static_cast<std::uint32_t>(views.front().pixels());
    to.camera.push_back(from.pixel[i] / view_pixels);
    to.pixel.push_back(from.pixel[i] % view_pixels);
  }
  return round;
}

/// One view's surface, taken apart.
struct ViewSurface {
  std::vector<float> depth_m, cosine, footprint_m;
  std::vector<std::uint32_t> object_id;
  std::vector<bool> edge;
  DropCounts dropped;
};

inline ViewSurface analyse_surface(const InputView& view) {
  const InputView* const pointer = &view;
  Sampler sampler(Device::Cpu);
  const RoundPixels pixels = sampler.measure({&pointer, 1}, view.objects, {});
  ViewSurface surface;
  for (std::size_t i = 0; i < view.pixels(); ++i) {
    surface.depth_m.push_back(pixels.depth_m[i]);
    surface.cosine.push_back(pixels.cosine[i]);
    surface.footprint_m.push_back(pixels.surfels[i].footprint_m);
    surface.object_id.push_back(pixels.surfels[i].object_id);
    surface.edge.push_back(pixels.edges[i]);
  }
  surface.dropped = dropped_of(pixels.tally->faults[0]);
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
