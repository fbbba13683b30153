#pragma once

#include <atomic>
#include <condition_variable>
#include <deque>
#include <memory>
#include <mutex>
#include <span>
#include <thread>
#include <vector>

#include "bus/context.h"
#include "bus/publisher.h"
#include "bus/tensor_ring.h"
#include "capture-bridge/requests.h"
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

struct InputJob {
  std::vector<InputViewPointer> views;
  std::uint64_t rig_generation = 0;
  SamplingOptions options;
  bool glance = false;  ///< a look ahead of the round; it takes no round's place
};

struct PublishedRound {
  std::uint64_t rig_generation = 0;  ///< 0: of a glance
  std::size_t samples = 0;
};

/// What the worker has done so far.
struct InputStatistics {
  std::uint64_t rounds = 0;  ///< published
  std::size_t samples = 0;   ///< of the last round
  std::size_t culled = 0, thinned = 0, dropped = 0;
  double milliseconds = 0;  ///< the last round's sampling
};

/// Samples rounds and publishes them on a thread of its own, so that forwarding frames never waits for it.
class InputWorker {
 public:
  /// `expected` is what is to be expected of a round. Returns when sampling is ready. Throws std::runtime_error when
  /// the backend cannot be had.
  InputWorker(const std::shared_ptr<bus::Context>& context, Device backend, const RoundSizes& expected);
  ~InputWorker();

  static constexpr std::size_t kMaxQueued = 16;

  /// Queues a round. What of the same rig still waits, and a look of it, is replaced; others wait their turn, the
  /// oldest of more than kMaxQueued is dropped.
  void submit(InputJob job);
  [[nodiscard]] InputStatistics statistics() const;
  /// Rounds that were published since this was asked last, in their order; the last few, when it is never asked.
  [[nodiscard]] std::vector<PublishedRound> take_published();
  /// Whether a round has failed since this was asked last.
  [[nodiscard]] bool take_failure() { return failed_.exchange(false); }

 private:
  void run(const std::stop_token& stop);
  void process(const InputJob& job);

  Sampler sampler_;
  InputPublisher publisher_;
  mutable std::mutex mutex_;
  std::condition_variable_any wake_;
  std::deque<InputJob> jobs_;
  InputStatistics statistics_;
  std::vector<PublishedRound> published_;
  std::atomic<bool> failed_ = false;
  bool complained_ = false;
  std::jthread thread_;  // last: it uses everything above
};

}  // namespace splatbus::capture_bridge
