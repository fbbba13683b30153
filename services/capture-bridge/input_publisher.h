#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <span>

#include "bus/publisher.h"
#include "bus/tensor_ring.h"
#include "capture-bridge/input_round.h"
#include "capture-bridge/sampler.h"

namespace splatbus::capture_bridge {

/// Publishes capture/input. Not thread-safe.
class InputPublisher {
 public:
  /// The ring lies in memory of `kind`, with room for what is to be expected of a round.
  InputPublisher(const std::shared_ptr<bus::Context>& context, Device kind, const RoundSizes& expected);

  /// `views` are those that `round` was sampled from; all have pictures of one size. `newest` is the round's frame.
  void publish(std::span<const InputViewPointer> views, const InputView& newest, std::uint64_t rig_generation,
               const RoundSamples& round);

 private:
  bus::Publisher publisher_;
  bus::TensorRing ring_;
};

}  // namespace splatbus::capture_bridge
