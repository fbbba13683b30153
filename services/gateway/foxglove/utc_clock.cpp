#include "gateway/foxglove/utc_clock.h"

#include <time.h>

#include <algorithm>
#include <cstdlib>

namespace splatbus::gateway::foxglove {

namespace {

constexpr std::int64_t kStepNs = 1'000'000;  // and not less: what is less is no step of a clock

}  // namespace

std::int64_t realtime_ns() {
  timespec now{};
  ::clock_gettime(CLOCK_REALTIME, &now);
  return std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
}

UtcClock::UtcClock(Clock realtime, Clock monotonic) : realtime_(realtime), monotonic_(monotonic) {
  offset_ns_ = realtime_() - monotonic_();
}

std::uint64_t UtcClock::utc(std::int64_t monotonic_ns) {
  follow();
  return static_cast<std::uint64_t>(std::max<std::int64_t>(0, monotonic_ns + offset_ns_));
}

void UtcClock::follow() {
  const std::int64_t before = monotonic_();
  const std::int64_t realtime = realtime_();
  const std::int64_t after = monotonic_();
  const std::int64_t offset = realtime - (before + (after - before) / 2);
  // Who was held up between the readings knows no better; the next one will.
  if (std::abs(offset - offset_ns_) > kStepNs + (after - before)) offset_ns_ = offset;
}

}  // namespace splatbus::gateway::foxglove
