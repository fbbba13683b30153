#pragma once

#include <cstdint>

#include "expander/insertion.h"
#include "gaussians/frames.h"

namespace splatbus::expander {

/// A sample in the frame that its Gaussian is to live in.
struct LocalSample {
  std::uint32_t frame_id;
  float metres_per_unit;
  math::Vec3 position, normal;  ///< in the frame's units
  float spacing_m;

  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER math::Vec3 position_m() const { return position * metres_per_unit; }
};

SPLATBUS_PORTABLE LocalSample localised(const Samples& samples, const ObjectFrames& frames, std::uint32_t i) {
  LocalSample local{kWorldFrame, 1, samples.position[i], samples.normal[i],
                    math::larger(samples.spacing_m[i], kMinSpacing_m)};
  if (const ObjectFrame* const object = frames.find(samples.object_id[i])) {
    const math::Similarity& object_from_world = object->object_from_world;
    local.frame_id = object->id;
    local.metres_per_unit = 1.0F / object_from_world.scale;
    local.position = transformed(object_from_world, local.position);
    local.normal = object_from_world.rotation * local.normal;
  }
  return local;
}

}  // namespace splatbus::expander
