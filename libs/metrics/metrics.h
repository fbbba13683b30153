#pragma once

#include <opencv2/core.hpp>
#include <string>

namespace splatbus::metrics {

// Images are cv::Mat CV_8UC3 in BGR order, display space (sRGB), of one size. Each throws std::invalid_argument naming
// the mismatch.

/// dB, peak 255; +infinity for equal images.
[[nodiscard]] double psnr(const cv::Mat& image, const cv::Mat& reference);

/// Mean SSIM over RGB (Wang et al. 2004): Gaussian window 11x11, sigma 1.5, K1 0.01, K2 0.03, valid region only... see .cpp;
/// `map`, when not null, receives CV_32FC1.
[[nodiscard]] double ssim(const cv::Mat& image, const cv::Mat& reference, cv::Mat* map = nullptr);

/// Mean LDR-FLIP (Andersson et al. 2020); `map` receives CV_32FC1 in [0, 1].
[[nodiscard]] double flip(const cv::Mat& image, const cv::Mat& reference, double pixels_per_degree = 67.0, cv::Mat* map = nullptr);

/// A CV_32FC1 map in [0, 1] in false colours (magma), CV_8UC3 BGR.
[[nodiscard]] cv::Mat colorize(const cv::Mat& map);

struct Quality { double psnr_db = 0, ssim = 0, flip = 0; };
[[nodiscard]] Quality compare(const cv::Mat& image, const cv::Mat& reference);

}  // namespace splatbus::metrics
