#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

#include "bus/backend.h"
#include "capture-bridge/input_view.h"
#include "capture-bridge/rig.h"
#include "capture-bridge/round_plan.h"

namespace splatbus::capture_bridge {

/// What a round of input views comes to, as arrays in one kind of memory, written to the end. Meanings and shapes:
/// schemas/capture.fbs, CaptureInput; position and normal are in the round's frame.
struct RoundSamples : RoundCounts {
  Device memory = Device::Cpu;
  std::size_t size = 0;
  const float *position = nullptr, *normal = nullptr, *albedo = nullptr, *color = nullptr;
  const float *footprint_m = nullptr, *spacing_m = nullptr, *cosine = nullptr;
  const std::uint32_t *object_id = nullptr, *camera = nullptr;
  const float* depth_m = nullptr;
  ContentHeights heights;
};

/// Turns rounds of input views into samples; one thread at a time. All implementations give the same samples, in the
/// same order, but for what the host's and the device's sums may round differently.
class Sampler {
 public:
  virtual ~Sampler() = default;

  /// `views` are of one size, their pictures in the sampler's kind of memory; `round_objects` are the transforms of the
  /// round's frame, to which samples of moving objects are brought. The arrays hold until the next call. Throws
  /// std::runtime_error.
  [[nodiscard]] virtual RoundSamples sample(Views views, const ObjectTransforms& round_objects,
                                            const SamplingOptions& options) = 0;
};

/// A sampler whose first round takes no longer than the others, up to the sizes that are expected. Its memory and that
/// of its views is backend. Throws std::runtime_error.
[[nodiscard]] std::unique_ptr<Sampler> make_sampler(Device backend, const RoundSizes& expected);

}  // namespace splatbus::capture_bridge
