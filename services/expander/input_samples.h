#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <optional>
#include <string>
#include <vector>

#include "bus/subscriber.h"
#include "gaussians/camera.h"
#include "gaussians/light.h"

namespace splatbus::expander {

/// One round of capture/input in host memory; every sample is finite, with a unit normal, a positive spacing and a
/// camera that exists. Meanings: schemas/capture.fbs, CaptureInput.
struct InputSamples {
  std::uint64_t frame = 0, rig_generation = 0;
  double time_s = 0;
  std::int64_t capture_ns = 0;
  std::vector<Camera> cameras;
  ObjectTransforms objects;
  Light light;
  std::vector<glm::vec3> position, normal, albedo, color;
  std::vector<float> spacing_m, cosine;
  std::vector<std::uint32_t> object_id, camera;
  std::vector<float> depth_m;  ///< [cameras][height][width]
  std::uint32_t height = 0, width = 0;
  std::size_t dropped = 0;  ///< samples that were garbage

  [[nodiscard]] std::size_t size() const { return position.size(); }
};

/// Copies a round out of its slab and drops samples that are garbage. Nullopt when the slab has moved on. Throws
/// bus::Error or std::runtime_error, naming what is wrong, when the message lies.
[[nodiscard]] std::optional<InputSamples> decode_input(const bus::Message& message);

/// Removes samples that are not finite, or whose normal, spacing or camera make no sense; counts them in `dropped`.
void drop_garbage(InputSamples& samples);

}  // namespace splatbus::expander
