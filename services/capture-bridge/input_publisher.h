#pragma once

#include <cstdint>
#include <memory>
#include <span>

#include "bus/publisher.h"
#include "bus/tensor_ring.h"
#include "capture-bridge/input_round.h"
#include "capture-bridge/sampling.h"

namespace splatbus::capture_bridge {

/// Publishes capture/input. Not thread-safe.
class InputPublisher {
 public:
  /// `most_samples` and `depth_pixels` of all cameras are what to expect of a round.
  InputPublisher(const std::shared_ptr<bus::Context>& context, std::size_t most_samples, std::size_t depth_pixels);

  /// `views` are those that `round` was sampled from; all have pictures of one size. `newest` is the round's frame.
  void publish(std::span<const InputViewPointer> views, const InputView& newest, std::uint64_t rig_generation,
               const SampledRound& round);

 private:
  bus::Publisher publisher_;
  bus::TensorRing ring_;
};

}  // namespace splatbus::capture_bridge
