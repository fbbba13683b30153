#pragma once

#include <opencv2/core.hpp>
#include <string>
#include <vector>

namespace splatbus::metrics {

struct PlotLine {
  std::string name;
  std::vector<double> x, y;  ///< of one length; where y is not finite the line has a gap
};

/// A vertical line at x.
struct PlotMark {
  double x = 0;
  std::string name;
};

/// Lines over one axis; both axes begin at 0 where nothing is below it, but where `y_from` says otherwise.
struct Plot {
  std::string title;  ///< with the unit of y
  std::string x_label;
  std::vector<PlotLine> lines;
  std::vector<PlotMark> marks;
  double y_from = 0;
};

/// The plots one below the other as CV_8UC3 BGR. Text is ASCII. Throws std::invalid_argument where a line's x and y
/// differ in length, and where there is no plot.
[[nodiscard]] cv::Mat draw(const std::vector<Plot>& plots);

}  // namespace splatbus::metrics
