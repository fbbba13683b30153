#pragma once

#include <array>
#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <thread>
#include <vector>

#include "bus/context.h"
#include "bus/publisher.h"
#include "bus/tensor_ring.h"
#include "capture-bridge/requests.h"
#include "capture-bridge/sampler.h"

namespace splatbus::capture_bridge {

/// Of capture/input: position first, whose rows are the samples.
inline constexpr std::array kSampleTensors{"position", "normal", "albedo", "color", "spacing", "object_id"};
/// A ring of rounds' samples: its slots, and their bytes where a round has so many samples.
inline constexpr std::size_t kSampleSlots = 4;
[[nodiscard]] std::size_t sample_slot_bytes(std::size_t samples);
[[nodiscard]] std::vector<bus::TensorSource> sample_tensors(const RoundSamples& round);

struct InputJob {
  std::vector<InputViewPointer> views;  ///< to be sampled, of one size
  std::uint64_t rig_generation = 0;
  SamplingOptions options;
  bool glance = false;  ///< a look ahead of the round; it takes no round's place
};

/// Whose frame is the round's. There is a view.
[[nodiscard]] const InputView& newest_of(const InputJob& job);

/// Views are of one size unless the size was changed while a rig was captured; then the newest size counts.
void keep_one_size(InputJob& job);

/// What a job has come to.
struct RoundResult {
  std::vector<bus::OutgoingTensor> tensors;  ///< kSampleTensors
  std::size_t culled = 0, thinned = 0;
  DropCounts dropped;
  double milliseconds = 0;
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

/// Samples rounds and publishes them, as capture/input, on a thread of its own, so that forwarding frames never waits
/// for it. Thread-safe.
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
  /// What waits is dropped as if this round were submitted, whoever samples it.
  void replace_by(const InputJob& job);
  /// The round that has waited longest, for somebody else, while this worker samples another one.
  [[nodiscard]] std::optional<InputJob> take_waiting();
  /// It was sampled by nobody, and waits again, before all others; unless what came since replaces it.
  void take_back(InputJob job);
  /// Publishes what a round has come to.
  void publish(const InputJob& job, const RoundResult& result);

  [[nodiscard]] InputStatistics statistics() const;
  /// Rounds that were published since this was asked last, in their order; the last few, when it is never asked.
  [[nodiscard]] std::vector<PublishedRound> take_published();
  /// Whether a round has failed since this was asked last.
  [[nodiscard]] bool take_failure() { return failed_.exchange(false); }

 private:
  void run(const std::stop_token& stop);
  void process(const InputJob& job);

  Sampler sampler_;
  bus::Publisher publisher_;
  bus::TensorRing ring_;
  std::mutex publishing_;  // rounds are noted in the order in which they are published
  mutable std::mutex mutex_;
  std::condition_variable_any wake_;
  std::deque<InputJob> jobs_;
  bool samples_ = false;  // a round, at this moment
  InputStatistics statistics_;
  std::vector<PublishedRound> published_;
  std::atomic<bool> failed_ = false;
  bool complained_ = false;
  std::jthread thread_;  // last: it uses everything above
};

}  // namespace splatbus::capture_bridge
