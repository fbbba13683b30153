#pragma once

#include <opencv2/core.hpp>
#include <string>
#include <vector>

namespace splatbus::metrics {

/// One row: a picture for each column (an empty cv::Mat leaves its place blank) and lines of text beneath a heading.
struct ContactSheetRow {
  std::string caption;               ///< the heading left of the pictures, "camera 3"
  std::vector<std::string> figures;  ///< lines beneath it, "SSIM 0.971"
  std::vector<cv::Mat> pictures;     ///< CV_8UC3 BGR
};

struct ContactSheet {
  std::string title;                 ///< over everything; may be empty
  std::vector<std::string> columns;  ///< titles, "engine", "server", "viewer", "FLIP"
  std::vector<ContactSheetRow> rows;
  int picture_height = 256;  ///< pixels; pictures are scaled to it, their aspect kept
};

/// The sheet as CV_8UC3 BGR, dark text on a light ground. Text is ASCII. Throws std::invalid_argument when a row has
/// more pictures than there are columns, when one is not CV_8UC3, or when there is nothing to show.
[[nodiscard]] cv::Mat draw(const ContactSheet& sheet);

}  // namespace splatbus::metrics
