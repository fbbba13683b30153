#pragma once

#include <atomic>
#include <condition_variable>
#include <deque>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#include "bus/context.h"
#include "capture-bridge/input_round.h"
#include "capture-bridge/rig.h"
#include "capture-bridge/sampling.h"

namespace splatbus::capture_bridge {

struct InputJob {
  std::vector<InputViewPointer> views;
  std::uint64_t rig_generation = 0;
  SamplingOptions options;
};

/// What the worker has done so far.
struct InputStatistics {
  std::uint64_t rounds = 0;  ///< published
  std::size_t samples = 0;   ///< of the last round
  std::size_t culled = 0, thinned = 0, dropped = 0;
  double milliseconds = 0;  ///< the last round's sampling
  ContentHeights heights;   ///< of the last round's samples
};

/// Samples rounds and publishes them on a thread of its own, so that forwarding frames never waits for it.
class InputWorker {
 public:
  /// `most_samples` and `depth_pixels` of all cameras are what to expect of a round.
  InputWorker(std::shared_ptr<bus::Context> context, std::size_t most_samples, std::size_t depth_pixels);
  ~InputWorker();

  /// Queues a round. One of the same rig that still waits is replaced; others wait their turn, the oldest of more than
  /// four is dropped.
  void submit(InputJob job);
  [[nodiscard]] InputStatistics statistics() const;

 private:
  void run(const std::stop_token& stop);

  std::shared_ptr<bus::Context> context_;
  std::size_t most_samples_, depth_pixels_;
  mutable std::mutex mutex_;
  std::condition_variable_any wake_;
  std::deque<InputJob> jobs_;
  InputStatistics statistics_;
  std::jthread thread_;  // last: it uses everything above
};

/// Heights of the middle 96 % of the samples. Everything, when there are none.
[[nodiscard]] ContentHeights content_heights(const SampleSet& samples);

}  // namespace splatbus::capture_bridge
