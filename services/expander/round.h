#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "bus/subscriber.h"
#include "gaussians/camera.h"
#include "gaussians/light.h"

namespace splatbus::expander {

/// What a round of capture/input says beside its samples. Meanings: schemas/capture.fbs, CaptureInput.
struct RoundInfo {
  std::uint64_t frame = 0, rig_generation = 0;
  double time_s = 0;
  std::int64_t capture_ns = 0, publish_ns = 0;
  std::vector<Camera> cameras;
  ObjectTransforms objects;
  Light light;
  std::uint32_t height = 0, width = 0;  ///< of the depth maps
};

/// A round whose samples still lie where its sender put them, in either kind of memory; sizes and types agree, values
/// may be garbage.
struct IncomingRound : RoundInfo {
  std::size_t count = 0;
  bus::TensorView position, normal, albedo, color;  ///< f32 [count][3]
  bus::TensorView spacing, cosine;                  ///< f32 [count]
  bus::TensorView object_id, camera;                ///< u32 [count]
  bus::TensorView depth;                            ///< f32 [cameras][height][width]
};

/// Nullopt when the round's slab is gone or has moved on. Throws bus::Error or std::runtime_error, naming what is
/// wrong, when the message lies.
[[nodiscard]] std::optional<IncomingRound> open_round(const bus::Message& message);

/// A round in memory of our own, of the kind that its mapper works in; every sample is finite, with a unit normal, a
/// positive spacing and a camera that exists.
class Round {
 public:
  virtual ~Round() = default;
  [[nodiscard]] virtual const RoundInfo& info() const = 0;
  [[nodiscard]] virtual std::size_t size() const = 0;
  [[nodiscard]] virtual std::size_t dropped() const = 0;  ///< samples that were garbage
};

}  // namespace splatbus::expander
