#include <opencv2/imgproc.hpp>
#include <stdexcept>

#include "metrics/metrics.h"

namespace splatbus::metrics {

cv::Mat colorize(const cv::Mat& map) {
  if (map.empty() || map.dims != 2 || map.type() != CV_32FC1) {
    throw std::invalid_argument("colorize: the map is empty or not of type CV_32FC1");
  }
  cv::Mat finite = map.clone(), bytes, out;
  cv::patchNaNs(finite, 0);
  finite.convertTo(bytes, CV_8U, 255);  // saturates
  cv::applyColorMap(bytes, out, cv::COLORMAP_MAGMA);
  return out;
}

}  // namespace splatbus::metrics
