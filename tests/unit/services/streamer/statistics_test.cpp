#include <gtest/gtest.h>

#include "../../nanoseconds.h"
#include "streamer/wire_statistics.h"

namespace splatbus::streamer {
namespace {

TEST(WireStatistics, CountsByTypeAndLeavesProbePicturesOutOfTheRates) {
  WireStatistics statistics;
  statistics.begin(5 * kSecond);
  statistics.add(wire::Body::PageDelta, 100'000);
  statistics.add(wire::Body::PageDelta, 25'000);
  statistics.add(wire::Body::ProbePicture, 1'000'000);
  auto window = statistics.close_window(6 * kSecond);
  EXPECT_DOUBLE_EQ(window.seconds, 1);
  EXPECT_DOUBLE_EQ(window.mbps, 1);
  EXPECT_EQ(window.bytes, 1'125'000U);
  EXPECT_EQ(window.types[static_cast<std::size_t>(wire::Body::PageDelta)].packets, 2U);
  window = statistics.close_window(7 * kSecond);
  EXPECT_DOUBLE_EQ(window.mbps, 0);
  EXPECT_DOUBLE_EQ(window.mbps_mean, 0.5);
  EXPECT_DOUBLE_EQ(window.mbps_peak, 1);
  EXPECT_EQ(window.total_bytes, 1'125'000U);
}

TEST(WireStatistics, SaysNothingBeforeTheFirstViewer) {
  WireStatistics statistics;
  EXPECT_DOUBLE_EQ(statistics.close_window(kSecond).mbps_mean, 0);
  statistics.begin(10 * kSecond);
  statistics.begin(20 * kSecond);
  statistics.add(wire::Body::Page, 125'000);
  EXPECT_DOUBLE_EQ(statistics.close_window(11 * kSecond).mbps_mean, 1);
}

}  // namespace
}  // namespace splatbus::streamer
