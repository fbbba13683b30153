#pragma once

#include <cstdint>
#include <utility>

namespace splatbus::capture_bridge {

/// Pictures are published once and are not latched: a trainer that starts later, or again, has missed them. It says how
/// many views of a role it holds; this decides when to have the engine render them again: at once for a trainer that
/// has not been heard of before, else when none is under way. Bounded, for a trainer may leave views out on purpose.
/// Times are CLOCK_MONOTONIC nanoseconds.
class TrainerWatch {
 public:
  /// `epoch` of the trainer's stats, the views that it holds and those that were published for it; `last_view_ns` is
  /// when the last one was. True: publish all again.
  bool lacks_views(std::uint64_t epoch, std::uint64_t held, std::uint64_t published, std::int64_t last_view_ns,
                   std::int64_t now_ns) {
    const bool is_new = std::exchange(epoch_, epoch) != epoch;
    if (is_new) demands_ = 0;
    if (held >= published || demands_ >= kMaxDemands) return false;
    if (!is_new && now_ns - last_view_ns < kPatienceNs) return false;
    if (now_ns - last_demand_ns_ < (is_new ? kNewcomerPatienceNs : kPatienceNs)) return false;
    ++demands_;
    last_demand_ns_ = now_ns;
    return true;
  }

 private:
  static constexpr std::int64_t kPatienceNs = 2'000'000'000;
  static constexpr std::int64_t kNewcomerPatienceNs = 250'000'000;  ///< of those that come one after the other
  static constexpr int kMaxDemands = 4;
  std::uint64_t epoch_ = 0;
  int demands_ = 0;
  std::int64_t last_demand_ns_ = 0;
};

}  // namespace splatbus::capture_bridge
