#include <cmath>
#include <limits>

#include "metrics/images.h"
#include "metrics/metrics.h"

namespace splatbus::metrics {

double psnr(const cv::Mat& image, const cv::Mat& reference) {
  check_images("psnr", image, reference);
  const double squared = cv::norm(image, reference, cv::NORM_L2SQR);
  if (squared == 0) return std::numeric_limits<double>::infinity();
  const double mean_squared = squared / (static_cast<double>(image.total()) * image.channels());
  return 10 * std::log10(255.0 * 255.0 / mean_squared);
}

Quality compare(const cv::Mat& image, const cv::Mat& reference) {
  return {psnr(image, reference), ssim(image, reference), flip(image, reference)};
}

}  // namespace splatbus::metrics
