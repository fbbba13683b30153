#include "metrics/metrics.h"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>
#include <stdexcept>

namespace splatbus::metrics {
namespace {

constexpr int kWindow = 11, kRadius = kWindow / 2;
constexpr double kSigma = 1.5;
constexpr double kC1 = (0.01 * 255) * (0.01 * 255), kC2 = (0.03 * 255) * (0.03 * 255);

// In double: the variances are differences of large, nearly equal numbers.
cv::Mat window_mean(const cv::Mat& plane) {
  cv::Mat out;
  cv::GaussianBlur(plane, out, {kWindow, kWindow}, kSigma, kSigma, cv::BORDER_REFLECT);
  return out;
}

/// SSIM of one channel at every pixel (Wang et al. 2004, equation 13).
cv::Mat ssim_plane(const cv::Mat& x, const cv::Mat& y) {
  const cv::Mat mean_x = window_mean(x), mean_y = window_mean(y);
  const cv::Mat mean_xx = window_mean(x.mul(x)), mean_yy = window_mean(y.mul(y)), mean_xy = window_mean(x.mul(y));
  cv::Mat out(x.size(), CV_64F);
  for (int row = 0; row < out.rows; ++row) {
    const auto* mx = mean_x.ptr<double>(row);
    const auto* my = mean_y.ptr<double>(row);
    const auto* xx = mean_xx.ptr<double>(row);
    const auto* yy = mean_yy.ptr<double>(row);
    const auto* xy = mean_xy.ptr<double>(row);
    auto* ssim_row = out.ptr<double>(row);
    for (int col = 0; col < out.cols; ++col) {
      const double mean_product = mx[col] * my[col], mean_squares = mx[col] * mx[col] + my[col] * my[col];
      const double covariance = xy[col] - mean_product, variances = xx[col] + yy[col] - mean_squares;
      ssim_row[col] = (2 * mean_product + kC1) * (2 * covariance + kC2) / ((mean_squares + kC1) * (variances + kC2));
    }
  }
  return out;
}

}  // namespace

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

double ssim(const cv::Mat& image, const cv::Mat& reference, cv::Mat* map) {
  check_images("ssim", image, reference, kWindow);
  cv::Mat image_f, reference_f;
  image.convertTo(image_f, CV_64F);
  reference.convertTo(reference_f, CV_64F);
  std::array<cv::Mat, 3> x, y;
  cv::split(image_f, x.data());
  cv::split(reference_f, y.data());
  cv::Mat sum = cv::Mat::zeros(image.size(), CV_64F);
  for (std::size_t channel = 0; channel < x.size(); ++channel) sum += ssim_plane(x[channel], y[channel]);
  sum /= static_cast<double>(x.size());
  if (map != nullptr) sum.convertTo(*map, CV_32F);
  const cv::Rect inside(kRadius, kRadius, image.cols - 2 * kRadius, image.rows - 2 * kRadius);
  return cv::mean(sum(inside))[0];
}

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
