#include <gtest/gtest.h>

#include "gateway/foxglove/utc_clock.h"

namespace splatbus::gateway::foxglove {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000, kHour = 3600 * kSecond, k2026 = 56LL * 365 * 24 * kHour;

/// Two clocks that a test sets. Time passes while the monotonic one is read.
struct Clocks {
  static inline std::int64_t realtime_ns = 0, monotonic_ns = 0, reading_ns = 0;
  static std::int64_t realtime() { return realtime_ns; }
  static std::int64_t monotonic() {
    pass(reading_ns);
    return monotonic_ns;
  }
  static void pass(std::int64_t time_ns) {
    realtime_ns += time_ns;
    monotonic_ns += time_ns;
  }
};

class FoxgloveClock : public testing::Test {
 protected:
  FoxgloveClock() {
    Clocks::realtime_ns = k2026;
    Clocks::monotonic_ns = 5 * kSecond;
    Clocks::reading_ns = 0;
  }
};

TEST_F(FoxgloveClock, IsThatOfDay) {
  UtcClock clock(Clocks::realtime, Clocks::monotonic);
  EXPECT_EQ(clock.utc(3 * kSecond), static_cast<std::uint64_t>(k2026 - 2 * kSecond));
  Clocks::pass(kHour);
  EXPECT_EQ(clock.utc(Clocks::monotonic_ns), static_cast<std::uint64_t>(k2026 + kHour));
  UtcClock of_machine;
  EXPECT_NEAR(static_cast<double>(of_machine.utc(bus::now_ns())), static_cast<double>(realtime_ns()), 1e9);
}

TEST_F(FoxgloveClock, FollowsAMachineThatSleptAndAClockThatIsSet) {
  UtcClock clock(Clocks::realtime, Clocks::monotonic);
  Clocks::realtime_ns += 8 * kHour;  // CLOCK_MONOTONIC stands still while the machine sleeps
  EXPECT_EQ(clock.utc(Clocks::monotonic_ns), static_cast<std::uint64_t>(k2026 + 8 * kHour));
  Clocks::realtime_ns -= 2 * kHour;
  EXPECT_EQ(clock.utc(Clocks::monotonic_ns), static_cast<std::uint64_t>(k2026 + 6 * kHour));
}

TEST_F(FoxgloveClock, IsNotMovedByHowItIsRead) {
  UtcClock clock(Clocks::realtime, Clocks::monotonic);
  const std::uint64_t before = clock.utc(5 * kSecond);
  Clocks::realtime_ns += 900'000;
  EXPECT_EQ(clock.utc(5 * kSecond), before);
  Clocks::reading_ns = 2 * kSecond;  // the thread was held up between two readings
  EXPECT_EQ(clock.utc(5 * kSecond), before);
}

}  // namespace
}  // namespace splatbus::gateway::foxglove
