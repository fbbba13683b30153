#include "metrics/images.h"

#include <fmt/format.h>

#include <stdexcept>

namespace splatbus::metrics {

void check_images(const char* who, const cv::Mat& image, const cv::Mat& reference, int min_side) {
  const auto check = [who, min_side](const char* which, const cv::Mat& mat) {
    if (mat.empty()) throw std::invalid_argument(fmt::format("{}: the {} is empty", who, which));
    if (mat.dims != 2 || mat.type() != CV_8UC3) {
      throw std::invalid_argument(fmt::format("{}: the {} is not of type CV_8UC3", who, which));
    }
    if (mat.rows < min_side || mat.cols < min_side) {
      throw std::invalid_argument(
          fmt::format("{}: the {} is {}x{}, sides must be at least {}", who, which, mat.cols, mat.rows, min_side));
    }
  };
  check("image", image);
  check("reference", reference);
  if (image.size() != reference.size()) {
    throw std::invalid_argument(fmt::format("{}: the image is {}x{}, the reference {}x{}", who, image.cols, image.rows,
                                            reference.cols, reference.rows));
  }
}

}  // namespace splatbus::metrics
