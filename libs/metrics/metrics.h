#pragma once

#include <opencv2/core.hpp>

namespace splatbus::metrics {

// Images are cv::Mat CV_8UC3 in BGR order, display space (sRGB), of one size. Each function throws
// std::invalid_argument that names the mismatch: an empty image, another type, another size, a side too short for the
// window.

/// Throws std::invalid_argument, beginning with `who`, unless both are CV_8UC3 of one size with sides of at least
/// `min_side` pixels.
void check_images(const char* who, const cv::Mat& image, const cv::Mat& reference, int min_side = 1);

/// dB over all three channels, peak 255; +infinity for equal images.
[[nodiscard]] double psnr(const cv::Mat& image, const cv::Mat& reference);

/// Mean SSIM (Wang et al. 2004), computed on R, G and B each and averaged: Gaussian window 11x11, sigma 1.5, K1 0.01,
/// K2 0.03, L 255, population variances. The mean runs over the pixels whose window lies inside the picture, so 5
/// pixels at each border do not count: the figure of scikit-image's structural_similarity(gaussian_weights=True,
/// sigma=1.5, use_sample_covariance=False, data_range=255, channel_axis=2). Sides are at least 11 pixels. `map`, when
/// not null, receives CV_32FC1 of the whole size, mean of the channels, borders mirrored for the window.
[[nodiscard]] double ssim(const cv::Mat& image, const cv::Mat& reference, cv::Mat* map = nullptr);

/// Mean LDR-FLIP (Andersson et al., "FLIP: A Difference Evaluator for Alternating Images", HPG 2020), 0 is best. 67
/// pixels a degree is a 0.7 m wide 4K monitor seen from 0.7 m. `map`, when not null, receives CV_32FC1 in [0, 1].
inline constexpr double kFlipPixelsPerDegree = 67;
[[nodiscard]] double flip(const cv::Mat& image, const cv::Mat& reference,
                          double pixels_per_degree = kFlipPixelsPerDegree, cv::Mat* map = nullptr);

/// A CV_32FC1 map in [0, 1] in false colors (magma), CV_8UC3 BGR. Values outside are clamped, NaN is 0.
[[nodiscard]] cv::Mat colorize(const cv::Mat& map);

struct Quality {
  double psnr_db = 0, ssim = 0, flip = 0;
};
[[nodiscard]] Quality compare(const cv::Mat& image, const cv::Mat& reference);

}  // namespace splatbus::metrics
