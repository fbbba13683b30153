#pragma once

#include <cstdint>

#include "bus/clock.h"

namespace splatbus::gateway::foxglove {

/// Nanoseconds since 1970, now.
[[nodiscard]] std::int64_t realtime_ns();

/// Brings times of CLOCK_MONOTONIC to UTC, by how far the two are apart now: they part where the machine sleeps or its
/// clock is set. A difference that is only how well two clocks can be read together is left as it was, so that
/// messages keep their distances. Not thread-safe.
class UtcClock {
 public:
  using Clock = std::int64_t (*)();
  explicit UtcClock(Clock realtime = realtime_ns, Clock monotonic = bus::now_ns);

  [[nodiscard]] std::uint64_t utc(std::int64_t monotonic_ns);

 private:
  void follow();

  const Clock realtime_, monotonic_;
  std::int64_t offset_ns_ = 0;
};

}  // namespace splatbus::gateway::foxglove
