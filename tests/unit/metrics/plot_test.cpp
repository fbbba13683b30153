#include "metrics/plot.h"

#include <gtest/gtest.h>

#include <cmath>
#include <stdexcept>

namespace splatbus::metrics {
namespace {

/// Rows of a column of the canvas where the first line's colour is, as a mean; -1 without any.
double height_at(const cv::Mat& canvas, int column) {
  double sum = 0;
  int count = 0;
  for (int row = 44; row < 272; ++row) {
    const auto& pixel = canvas.at<cv::Vec3b>(row, column);
    if (pixel[0] > 120 && pixel[2] < 60) {
      sum += row;
      ++count;
    }
  }
  return count == 0 ? -1 : sum / count;
}

TEST(Plot, DrawsALineWhereItsValuesAre) {
  const Plot plot{.title = "t", .x_label = "s", .lines = {{.name = "a", .x = {0, 50, 100}, .y = {0, 10, 5}}}};
  const cv::Mat canvas = draw({plot});
  ASSERT_EQ(canvas.type(), CV_8UC3);
  // 690 columns are 100 s, 228 rows are 10.
  EXPECT_NEAR(height_at(canvas, 90 + 690 / 4), 272 - 228 * 0.5, 2);
  EXPECT_NEAR(height_at(canvas, 90 + 690 / 2), 272 - 228 * 1.0, 3);
  EXPECT_NEAR(height_at(canvas, 90 + 690 * 3 / 4), 272 - 228 * 0.75, 2);
}

TEST(Plot, LeavesAGapWhereNothingWasMeasured) {
  const Plot plot{.title = "t",
                  .x_label = "s",
                  .lines = {{.name = "a", .x = {0, 40, 60, 80, 100}, .y = {10, 10, std::nan(""), 10, 10}}}};
  const cv::Mat canvas = draw({plot});
  EXPECT_GT(height_at(canvas, 90 + 690 * 2 / 10), 0);
  EXPECT_EQ(height_at(canvas, 90 + 690 * 6 / 10), -1);
  EXPECT_GT(height_at(canvas, 90 + 690 * 9 / 10), 0);
}

TEST(Plot, StacksPlotsAndRefusesWhatIsNone) {
  const Plot plot{.title = "t", .x_label = "s", .lines = {{.name = "a", .x = {0, 1}, .y = {0, 1}}}};
  EXPECT_EQ(draw({plot, plot}).rows, 2 * draw({plot}).rows);
  EXPECT_NO_THROW(static_cast<void>(draw({Plot{.title = "empty", .x_label = "s"}})));
  EXPECT_THROW(static_cast<void>(draw(std::vector<Plot>())), std::invalid_argument);
  const Plot odd{.title = "t", .x_label = "s", .lines = {{.name = "a", .x = {0, 1}, .y = {0}}}};
  EXPECT_THROW(static_cast<void>(draw({odd})), std::invalid_argument);
}

}  // namespace
}  // namespace splatbus::metrics
