#pragma once

#include <algorithm>
#include <cstdint>
#include <deque>
#include <vector>

#include "capture-bridge/input_worker.h"

namespace splatbus::capture_bridge {

/// Learns from the expander's state which share of a round's samples became Gaussians. It says how many rounds it has
/// processed and how many Gaussians it has inserted, both so far; rounds that lie between two of its words get the same
/// share. An estimate: a round that the expander lost shifts it by one.
class NewShareWatch {
 public:
  struct Share {
    std::uint64_t rig_generation = 0;
    float of_samples = 0;
  };

  void published(const std::vector<PublishedRound>& rounds) {
    waiting_.insert(waiting_.end(), rounds.begin(), rounds.end());
    while (waiting_.size() > kMaxWaiting) waiting_.pop_front();
  }

  /// `epoch` of the expander's state and both of its counts. Returns the rounds that it has processed since.
  std::vector<Share> state(std::uint64_t epoch, std::uint64_t rounds, std::uint64_t inserted) {
    std::vector<Share> shares;
    if (epoch == epoch_ && rounds > rounds_ && inserted >= inserted_) {
      double samples = 0;
      for (; shares.size() < rounds - rounds_ && !waiting_.empty(); waiting_.pop_front()) {
        shares.push_back({.rig_generation = waiting_.front().rig_generation});
        samples += static_cast<double>(waiting_.front().samples);
      }
      const double of_samples = samples > 0 ? static_cast<double>(inserted - inserted_) / samples : 0;
      for (Share& one : shares) one.of_samples = static_cast<float>(std::min(1.0, of_samples));
    }
    if (epoch != epoch_) waiting_.clear();
    epoch_ = epoch;
    rounds_ = rounds;
    inserted_ = inserted;
    return shares;
  }

 private:
  static constexpr std::size_t kMaxWaiting = 64;
  std::deque<PublishedRound> waiting_;  // that the expander has not said to have processed
  std::uint64_t epoch_ = 0, rounds_ = 0, inserted_ = 0;
};

}  // namespace splatbus::capture_bridge
