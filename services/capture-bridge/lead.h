#pragma once

#include <cstdint>
#include <string>
#include <utility>

#include "capture-bridge/seniority.h"

namespace splatbus::capture_bridge {

/// Whether this bridge is the one that writes: the first of those that the broker hears. Times are CLOCK_MONOTONIC
/// nanoseconds, the broker's, the bridges' and this process's: all on one machine. One thread.
class Lead {
 public:
  /// By its name, and when it was started: of the one before of the same name the broker may still speak.
  explicit Lead(Senior own) : own_(std::move(own)) {}

  void take(const wire::Liveness& liveness, std::int64_t now_ns);
  /// Who leads; empty until the broker has been heard, and one that was started again for long enough to have heard
  /// all.
  [[nodiscard]] const Senior& leader() const { return leader_; }
  [[nodiscard]] bool is_first() const { return leader_ == own_; }
  /// Whether it may write now, to be asked again and again. Who was stopped for so long that it may have been given up
  /// may not until the broker has said since that it is the first; and who comes into another's place waits until that
  /// one has read what it has read.
  [[nodiscard]] bool may_write(std::int64_t now_ns);

  /// For the user, while it may not.
  [[nodiscard]] std::string why_not() const;

  static constexpr std::int64_t kStalledNs = 1'000'000'000;
  static constexpr std::int64_t kHandoverNs = 200'000'000;

 private:
  Senior own_, leader_;
  std::int64_t said_ns_ = 0;        // by the broker, what is known
  std::int64_t trust_from_ns_ = 0;  // what it has said before counts for nothing
  std::int64_t asked_ns_ = 0;       // last
  std::int64_t begin_ns_ = 0;       // not before
};

}  // namespace splatbus::capture_bridge
