#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>

#include "bus/subscriber.h"

namespace splatbus::cli {

/// When a pipeline that starts has come how far, by the stamps of the messages that say so (CLOCK_MONOTONIC). Made
/// before the engine's first frame. Not thread-safe.
class StartWatch {
 public:
  /// `gaussians`: how many make the model count as there.
  StartWatch(std::shared_ptr<bus::Context> context, std::uint64_t gaussians);

  /// Takes in what has arrived.
  void poll(std::chrono::milliseconds timeout);

  [[nodiscard]] bool complete() const { return optimised_ns_.has_value(); }

  /// Seconds from the capture of the first engine/frame to the publishing of the first model/published that has enough
  /// Gaussians ("inserted_s"), that has them at step 1 or later ("ready_s"), and that has trained since it had them
  /// ("optimised_s"); null where it has not come to that.
  [[nodiscard]] nlohmann::json summary() const;

 private:
  void take(const wire::ModelPublished& published, const bus::Message& message);

  bus::Subscriber subscriber_;
  const std::uint64_t gaussians_;
  std::optional<std::int64_t> first_frame_ns_, inserted_ns_, ready_ns_, optimised_ns_;
  std::uint64_t inserted_at_step_ = 0;
};

}  // namespace splatbus::cli
