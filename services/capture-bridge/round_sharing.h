#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "bus/publisher.h"
#include "bus/subscriber.h"
#include "bus/tensor_ring.h"
#include "capture-bridge/input_worker.h"
#include "wire/sampling_generated.h"

namespace splatbus::wire {
struct Liveness;
}  // namespace splatbus::wire

namespace splatbus::capture_bridge {

/// Gives rounds of the bridge that leads to those that do not, one at a time each, so that all sample as many pixels.
/// It keeps every round until its answer is here: whatever becomes of a helper, its round comes back, and an answer
/// that comes after that counts for nothing. So each round is published once. Times are CLOCK_MONOTONIC nanoseconds.
/// One thread.
class RoundSharing {
 public:
  /// Pictures are handed on in memory of `kind`, with room for what is to be expected of a round; none is taken before
  /// the first.
  RoundSharing(const std::shared_ptr<bus::Context>& context, Device kind, const RoundSizes& expected);

  /// Helpers are the other bridges that run, as the broker sees it, once they have offered themselves.
  void take(const wire::Liveness& liveness);
  void offered(const wire::Header& by);

  /// Whether somebody has nothing to do.
  [[nodiscard]] bool has_idle(std::int64_t now_ns) const { return idle(now_ns) != nullptr; }
  /// Whether somebody has nothing to do, and has had less than this bridge.
  [[nodiscard]] bool is_anothers_turn(std::int64_t now_ns) const;
  /// Gives it a round. There is somebody.
  void hand(InputJob job, std::int64_t now_ns);
  /// This bridge samples it itself; or after all not.
  void keep(const InputJob& job) { own_pixels_ += pixels_of(job); }
  void keep_not(const InputJob& job) { own_pixels_ -= pixels_of(job); }

  struct Sampled {
    InputJob job;
    RoundResult result;
  };
  /// What a helper's answer comes to; nullopt when there is nothing to publish. Throws bus::Error when it lies; its
  /// round has come back then.
  [[nodiscard]] std::optional<Sampled> answered(const wire::SamplingResult& result, const bus::Message& message,
                                                std::int64_t now_ns);

  /// Rounds that nobody will bring: their helper is gone, takes too long, or has refused.
  [[nodiscard]] std::vector<InputJob> take_back(std::int64_t now_ns);

  [[nodiscard]] std::size_t helpers() const;  ///< that have offered themselves
  [[nodiscard]] std::uint64_t handed() const { return handed_; }
  [[nodiscard]] std::uint64_t came_back() const { return came_back_; }

  /// Waited for at least, and four times as long as its last round took. Who takes longer, or refuses, rests; until
  /// then if an answer comes.
  static constexpr std::int64_t kPatienceNs = 5'000'000'000, kRestNs = 10'000'000'000;

 private:
  struct InHand {
    std::uint64_t id = 0;
    InputJob job;
    std::int64_t since_ns = 0;
  };
  struct Helper {
    [[nodiscard]] bool idle(std::int64_t now_ns) const;
    /// The job that it has in hand, which it has no more.
    [[nodiscard]] InputJob let_go();

    std::uint64_t epoch = 0, offered_epoch = 0;  // of the process that runs; of the one that has offered itself
    std::optional<InHand> in_hand;
    std::int64_t pixels = 0;  // that it has had
    std::int64_t patience_ns = kPatienceNs, rests_until_ns = 0;
  };
  [[nodiscard]] static std::int64_t pixels_of(const InputJob& job);
  /// Who has had least; null where all are busy.
  [[nodiscard]] const std::pair<const std::string, Helper>* idle(std::int64_t now_ns) const;
  void come_back(Helper& helper);
  /// Whoever comes does not have to catch up.
  void count_anew();

  std::string own_;
  bus::Publisher publisher_;
  bus::TensorRing ring_;
  std::map<std::string, Helper> helpers_;
  std::int64_t own_pixels_ = 0;
  std::vector<InputJob> back_;
  std::uint64_t last_id_;
  std::uint64_t handed_ = 0, came_back_ = 0;
};

}  // namespace splatbus::capture_bridge
