#include "expander/visibility.h"

#include <cmath>

namespace splatbus::expander {

namespace {

bool depth_matches(const InputSamples& samples, std::size_t i, float tolerance) {
  const std::uint32_t index = samples.camera[i];
  const Camera& camera = samples.cameras[index];
  const glm::vec3 pixel = project(camera, samples.position[i]);
  if (!(pixel.z > 0) || !(pixel.x >= 0) || !(pixel.y >= 0) || pixel.x >= static_cast<float>(samples.width) ||
      pixel.y >= static_cast<float>(samples.height)) {
    return false;
  }
  const std::size_t row = std::size_t{index} * samples.height + static_cast<std::size_t>(pixel.y);
  const float depth = samples.depth_m[row * samples.width + static_cast<std::size_t>(pixel.x)];
  return std::abs(depth - pixel.z) <= tolerance * pixel.z;
}

}  // namespace

std::vector<bool> seen_samples(const InputSamples& samples, const VisibilityOptions& options) {
  std::vector<bool> seen(samples.size());
  for (std::size_t i = 0; i < samples.size(); ++i) {
    if (samples.cosine[i] < options.min_cosine) continue;
    seen[i] = samples.objects.contains(samples.object_id[i]) || depth_matches(samples, i, options.depth_tolerance);
  }
  return seen;
}

}  // namespace splatbus::expander
