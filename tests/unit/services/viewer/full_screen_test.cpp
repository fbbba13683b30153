#include "viewer/full_screen.h"

#include <gtest/gtest.h>

#include <array>

namespace splatbus::viewer {
namespace {

// The first, one to its right, and one above that.
constexpr std::array<std::array<int, 4>, 3> kPlaces{
    {{0, 0, 1920, 1080}, {1920, 0, 2560, 1440}, {1920, -1080, 1920, 1080}}};

std::size_t monitor_at(int x, int y, int width, int height) {
  std::array<cv::Rect, 3> monitors;
  for (std::size_t i = 0; i < monitors.size(); ++i) {
    const auto& [left, top, across, high] = kPlaces[i];
    monitors[i] = {left, top, across, high};
  }
  return monitor_of({x, y, width, height}, monitors);
}

TEST(FullScreen, TakesTheMonitorThatHasMostOfTheWindow) {
  EXPECT_EQ(monitor_at(100, 100, 1280, 720), 0);
  EXPECT_EQ(monitor_at(2000, 100, 1280, 720), 1);
  EXPECT_EQ(monitor_at(1920 - 600, 100, 1280, 720), 1) << "600 columns here, 680 there";
  EXPECT_EQ(monitor_at(1920 - 680, 100, 1280, 720), 0);
  EXPECT_EQ(monitor_at(2000, -400, 1280, 720), 2);
}

TEST(FullScreen, TakesTheFirstForAWindowThatIsNowhere) {
  EXPECT_EQ(monitor_at(-5000, -5000, 640, 480), 0);
}

}  // namespace
}  // namespace splatbus::viewer
