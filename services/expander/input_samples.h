#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <optional>
#include <vector>

#include "expander/round.h"

namespace splatbus::expander {

/// A round in host memory.
struct InputSamples : RoundInfo {
  std::vector<glm::vec3> position, normal, albedo, color;
  std::vector<float> spacing_m, cosine;
  std::vector<std::uint32_t> object_id, camera;
  std::vector<float> depth_m;  ///< [cameras][height][width]
  std::size_t dropped = 0;     ///< samples that were garbage

  [[nodiscard]] std::size_t size() const { return position.size(); }
};

/// What a sample must be to be taken; the same on every backend.
inline constexpr float kLargestSpacing_m = 1000;
inline constexpr float kUnitTolerance = 0.05F;  ///< of a normal's length

/// Copies a round to the host and drops samples that are garbage. Nullopt when a slab has moved on meanwhile. Adds what
/// was copied to `host_bytes`. Throws bus::Error.
[[nodiscard]] std::optional<InputSamples> copy_samples(const IncomingRound& round,
                                                       std::atomic<std::uint64_t>& host_bytes);

/// Removes samples that are not finite, or whose normal, spacing or camera make no sense; counts them in `dropped`.
void drop_garbage(InputSamples& samples);

}  // namespace splatbus::expander
