#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "bus/subscriber.h"
#include "metrics/metrics.h"

namespace splatbus::cli {

/// What the services last said about themselves on the topics that tell how far the pipeline is.
struct PipelineState {
  struct Trainer {
    std::uint64_t epoch = 0;  ///< of the process
    std::uint64_t step = 0, views = 0, gaussians = 0;
    double optimizer_s = 0, steps_per_s = 0, views_per_s = 0, loss = 0;
    std::uint32_t ready_references = 0, ready_inputs = 0;
    bool paused = false;
    std::uint64_t host_copied_bytes = 0, unpaired_views = 0;
    std::uint64_t active = 0, frozen = 0, spilled = 0;
    std::uint32_t pages_active = 0, pages_frozen = 0, pages_spilled = 0;
    std::uint64_t device_bytes = 0, host_bytes = 0, disk_bytes = 0;
    double masked_share = 0;
  };
  struct Grid {
    std::uint64_t rounds = 0, batches_pending = 0, gaussians_inserted = 0;
  };
  struct Stream {
    std::uint32_t viewers = 0;
    double wire_mbps = 0, wire_mbps_mean = 0, wire_mbps_peak = 0;
    std::map<std::string, std::uint64_t> total_bytes;  ///< to all viewers since the streamer started, by packet type
    std::int64_t published_ns = 0;
  };
  Trainer trainer;
  Grid grid;
  Stream stream;
  std::uint64_t page_bytes = 0;                              ///< of the published model's pages
  std::uint64_t visibility_generation = 0;                   ///< model generation of the newest relight/visibility
  std::map<std::uint64_t, metrics::Quality> viewer_quality;  ///< by probe id
  std::int64_t first_picture_ns = 0;                         ///< CLOCK_MONOTONIC, 0 before
};

/// Keeps a PipelineState up to date. Not thread-safe.
class PipelineWatch {
 public:
  explicit PipelineWatch(std::shared_ptr<bus::Context> context);

  void poll(std::chrono::milliseconds timeout);
  [[nodiscard]] const PipelineState& state() const { return state_; }

 private:
  bus::Subscriber subscriber_;
  PipelineState state_;
};

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
  /// ("optimized_s"); null where it has not come to that.
  [[nodiscard]] nlohmann::json summary() const;

 private:
  void take(const wire::ModelPublished& published, const bus::Message& message);

  bus::Subscriber subscriber_;
  const std::uint64_t gaussians_;
  std::optional<std::int64_t> first_frame_ns_, inserted_ns_, ready_ns_, optimised_ns_;
  std::uint64_t inserted_at_step_ = 0;
};

}  // namespace splatbus::cli
