#pragma once

#include <cstdint>

namespace splatbus::capture_bridge {

/// Pictures are published once and are not latched: a trainer that starts later, or again, has missed them. It says how
/// many views it holds; this decides when to have the engine render them again. Bounded, for a trainer may leave views
/// out on purpose. Times are CLOCK_MONOTONIC nanoseconds.
class TrainerWatch {
 public:
  /// `epoch` of the trainer's stats, the views that it holds and those that were published for it; `last_view_ns` is
  /// when the last one was. True: publish all again.
  bool lacks_views(std::uint64_t epoch, std::uint64_t held, std::uint64_t published, std::int64_t last_view_ns,
                   std::int64_t now_ns) {
    if (held >= published || now_ns - last_view_ns < kPatienceNs || now_ns - last_demand_ns_ < kPatienceNs)
      return false;
    if (epoch != epoch_) {
      epoch_ = epoch;
      demands_ = 0;
    }
    if (demands_ >= kMaxDemands) return false;
    ++demands_;
    last_demand_ns_ = now_ns;
    return true;
  }

 private:
  static constexpr std::int64_t kPatienceNs = 2'000'000'000;
  static constexpr int kMaxDemands = 4;
  std::uint64_t epoch_ = 0;
  int demands_ = 0;
  std::int64_t last_demand_ns_ = 0;
};

}  // namespace splatbus::capture_bridge
