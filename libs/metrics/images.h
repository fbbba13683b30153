#pragma once

#include <opencv2/core.hpp>

namespace splatbus::metrics {

/// Throws std::invalid_argument, beginning with `who`, unless both are CV_8UC3 of one size with sides of at least
/// `min_side` pixels.
void check_images(const char* who, const cv::Mat& image, const cv::Mat& reference, int min_side = 1);

}  // namespace splatbus::metrics
