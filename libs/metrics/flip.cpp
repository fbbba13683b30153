#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <stdexcept>
#include <utility>
#include <vector>

#include "gaussians/light.h"
#include "metrics/metrics.h"

// LDR-FLIP; section numbers are those of Andersson et al. 2020. Filters are separated: the color filters are sums of
// Gaussians, the feature filters products of a Gaussian and a derivative of it.

namespace splatbus::metrics {
namespace {

using Vec3 = cv::Vec3f;

constexpr float kColorExponent = 0.7F, kFeatureExponent = 0.5F;
constexpr float kErrorCut = 0.4F, kErrorAtCut = 0.95F;  // p_c, p_t of section 4.1.3
constexpr double kFeatureWidthDegrees = 0.082;
constexpr double kMaxPixelsPerDegree = 1000;  // filters of 300 taps

// XYZ from linear sRGB, D65.
const cv::Matx33f kXyzFromRgb(10135552.F / 24577794.F, 8788810.F / 24577794.F, 4435075.F / 24577794.F,
                              2613072.F / 12288897.F, 8788810.F / 12288897.F, 887015.F / 12288897.F,
                              1425312.F / 73733382.F, 8788810.F / 73733382.F, 70074185.F / 73733382.F);

/// XYZ relative to the white of linear RGB (1, 1, 1).
cv::Matx33f relative_xyz_from_rgb() {
  cv::Matx33f out = kXyzFromRgb;
  for (int row = 0; row < 3; ++row) {
    const float white = out(row, 0) + out(row, 1) + out(row, 2);
    for (int col = 0; col < 3; ++col) out(row, col) /= white;
  }
  return out;
}

/// YCxCz of section 4.1.1 and L*a*b* are the same combination, of relative XYZ and of its compressed form.
Vec3 opponent(const Vec3& xyz) {
  return {116 * xyz[1] - 16, 500 * (xyz[0] - xyz[1]), 200 * (xyz[1] - xyz[2])};
}

Vec3 relative_xyz_from_opponent(const Vec3& c) {
  const float y = (c[0] + 16) / 116;
  return {y + c[1] / 500, y, y - c[2] / 200};
}

/// L*a*b*, a* and b* adjusted for the Hunt effect (section 4.1.2).
Vec3 hunt_lab(const Vec3& relative_xyz) {
  constexpr float kDelta = 6.0F / 29, kCube = kDelta * kDelta * kDelta;
  Vec3 compressed;
  for (int i = 0; i < 3; ++i) {
    const float t = relative_xyz[i];
    compressed[i] = t > kCube ? std::cbrt(t) : t / (3 * kDelta * kDelta) + 4.0F / 29;
  }
  const Vec3 lab = opponent(compressed);
  return {lab[0], 0.01F * lab[0] * lab[1], 0.01F * lab[0] * lab[2]};
}

float hyab(const Vec3& a, const Vec3& b) {
  return std::abs(a[0] - b[0]) + std::hypot(a[1] - b[1], a[2] - b[2]);
}

/// The contrast sensitivity of one opponent channel: a sum of a_i sqrt(pi / b_i) exp(-pi^2 d^2 / b_i), d in degrees.
struct Sensitivity {
  std::array<double, 2> a, b;
};
constexpr std::array<Sensitivity, 3> kSensitivities = {
    {{{1, 0}, {0.0047, 1e-5}}, {{1, 0}, {0.0053, 1e-5}}, {{34.1, 13.5}, {0.04, 0.025}}}};
constexpr double kWidestScale = 0.04;

/// One-dimensional kernels whose outer squares add up to the channel's filter, normalised to sum 1.
std::vector<cv::Mat> sensitivity_kernels(const Sensitivity& sensitivity, double pixels_per_degree) {
  constexpr double kPi = std::numbers::pi;
  const int radius = static_cast<int>(std::ceil(3 * std::sqrt(kWidestScale / (2 * kPi * kPi)) * pixels_per_degree));
  std::vector<cv::Mat> kernels;
  double sum = 0;
  for (std::size_t i = 0; i < sensitivity.a.size(); ++i) {
    const double a = sensitivity.a[i], b = sensitivity.b[i];
    if (a == 0) continue;
    cv::Mat kernel(2 * radius + 1, 1, CV_64F);
    for (int x = -radius; x <= radius; ++x) {
      const double degrees = x / pixels_per_degree;
      kernel.at<double>(x + radius) = std::sqrt(a * std::sqrt(kPi / b)) * std::exp(-kPi * kPi * degrees * degrees / b);
    }
    const double taps = cv::sum(kernel)[0];
    sum += taps * taps;
    kernels.push_back(kernel);
  }
  for (cv::Mat& kernel : kernels) kernel.convertTo(kernel, CV_32F, 1 / std::sqrt(sum));
  return kernels;
}

cv::Mat filtered(const cv::Mat& plane, const cv::Mat& kernel_x, const cv::Mat& kernel_y) {
  cv::Mat out;
  cv::sepFilter2D(plane, out, CV_32F, kernel_x, kernel_y, {-1, -1}, 0, cv::BORDER_REPLICATE);
  return out;
}

using Planes = std::array<cv::Mat, 3>;

Planes opponent_planes(const cv::Mat& bgr, const cv::Matx33f& xyz_from_rgb) {
  std::array<float, 256> linear{};
  for (std::size_t i = 0; i < linear.size(); ++i) linear[i] = linear_from_srgb(static_cast<float>(i) / 255);
  cv::Mat out(bgr.size(), CV_32FC3);
  for (int row = 0; row < bgr.rows; ++row) {
    const auto* in = bgr.ptr<cv::Vec3b>(row);
    auto* to = out.ptr<Vec3>(row);
    for (int col = 0; col < bgr.cols; ++col) {
      to[col] = opponent(xyz_from_rgb * Vec3(linear[in[col][2]], linear[in[col][1]], linear[in[col][0]]));
    }
  }
  Planes planes;
  cv::split(out, planes.data());
  return planes;
}

/// What is left of a picture at that distance, as Hunt-adjusted L*a*b*.
cv::Mat perceived(const Planes& planes, const cv::Matx33f& xyz_from_rgb, double pixels_per_degree) {
  Planes blurred;
  for (std::size_t channel = 0; channel < planes.size(); ++channel) {
    for (const cv::Mat& kernel : sensitivity_kernels(kSensitivities[channel], pixels_per_degree)) {
      const cv::Mat part = filtered(planes[channel], kernel, kernel);
      blurred[channel] = blurred[channel].empty() ? part : blurred[channel] + part;
    }
  }
  const cv::Matx33f rgb_from_xyz = xyz_from_rgb.inv();
  cv::Mat out(planes[0].size(), CV_32FC3);
  for (int row = 0; row < out.rows; ++row) {
    const std::array<const float*, 3> in = {blurred[0].ptr<float>(row), blurred[1].ptr<float>(row),
                                            blurred[2].ptr<float>(row)};
    auto* to = out.ptr<Vec3>(row);
    for (int col = 0; col < out.cols; ++col) {
      Vec3 rgb = rgb_from_xyz * relative_xyz_from_opponent({in[0][col], in[1][col], in[2][col]});
      for (int i = 0; i < 3; ++i) rgb[i] = std::clamp(rgb[i], 0.0F, 1.0F);
      to[col] = hunt_lab(xyz_from_rgb * rgb);
    }
  }
  return out;
}

/// Section 4.1.3: the color difference, redistributed over [0, 1].
cv::Mat color_difference(const cv::Mat& a, const cv::Mat& b, const cv::Matx33f& xyz_from_rgb) {
  const float largest =
      std::pow(hyab(hunt_lab(xyz_from_rgb * Vec3(0, 1, 0)), hunt_lab(xyz_from_rgb * Vec3(0, 0, 1))), kColorExponent);
  const float cut = kErrorCut * largest;
  cv::Mat out(a.size(), CV_32F);
  for (int row = 0; row < out.rows; ++row) {
    const auto* in_a = a.ptr<Vec3>(row);
    const auto* in_b = b.ptr<Vec3>(row);
    auto* to = out.ptr<float>(row);
    for (int col = 0; col < out.cols; ++col) {
      const float error = std::pow(hyab(in_a[col], in_b[col]), kColorExponent);
      to[col] =
          error < cut ? error * kErrorAtCut / cut : kErrorAtCut + (error - cut) / (largest - cut) * (1 - kErrorAtCut);
    }
  }
  return out;
}

/// Section 4.2.1: a Gaussian and its first and second derivative; the positive weights of a derivative sum to 1, the
/// negative ones to -1.
struct FeatureKernels {
  cv::Mat smooth, edge, point;
};

FeatureKernels feature_kernels(double pixels_per_degree) {
  const double sigma = 0.5 * kFeatureWidthDegrees * pixels_per_degree;
  const int radius = static_cast<int>(std::ceil(3 * sigma));
  cv::Mat smooth(2 * radius + 1, 1, CV_64F), edge = smooth.clone(), point = smooth.clone();
  for (int x = -radius; x <= radius; ++x) {
    const double g = std::exp(-x * x / (2 * sigma * sigma));
    smooth.at<double>(x + radius) = g;
    edge.at<double>(x + radius) = -x * g;
    point.at<double>(x + radius) = (x * x / (sigma * sigma) - 1) * g;
  }
  const auto balanced = [](const cv::Mat& kernel) {
    const cv::Mat positive = cv::max(kernel, 0), negative = cv::max(-kernel, 0);
    return cv::Mat(positive / cv::sum(positive)[0] - negative / cv::sum(negative)[0]);
  };
  FeatureKernels out;
  cv::Mat(smooth / cv::sum(smooth)[0]).convertTo(out.smooth, CV_32F);
  balanced(edge).convertTo(out.edge, CV_32F);
  balanced(point).convertTo(out.point, CV_32F);
  return out;
}

/// Strength of edges and points at every pixel of the achromatic channel.
std::pair<cv::Mat, cv::Mat> features(const cv::Mat& achromatic, const FeatureKernels& kernels) {
  const cv::Mat y = (achromatic + 16) / 116;
  const auto strength = [&](const cv::Mat& derivative) {
    cv::Mat out;
    cv::magnitude(filtered(y, derivative, kernels.smooth), filtered(y, kernels.smooth, derivative), out);
    return out;
  };
  return {strength(kernels.edge), strength(kernels.point)};
}

/// Section 4.2.2.
cv::Mat feature_difference(const cv::Mat& a, const cv::Mat& b, double pixels_per_degree) {
  const FeatureKernels kernels = feature_kernels(pixels_per_degree);
  const auto [edge_a, point_a] = features(a, kernels);
  const auto [edge_b, point_b] = features(b, kernels);
  cv::Mat edge, point, out;
  cv::absdiff(edge_a, edge_b, edge);
  cv::absdiff(point_a, point_b, point);
  cv::pow(cv::max(edge, point) * (1 / std::numbers::sqrt2), kFeatureExponent, out);
  return out;
}

}  // namespace

double flip(const cv::Mat& image, const cv::Mat& reference, double pixels_per_degree, cv::Mat* map) {
  check_images("flip", image, reference);
  if (!(pixels_per_degree >= 1 && pixels_per_degree <= kMaxPixelsPerDegree)) {
    throw std::invalid_argument(
        fmt::format("flip: {} pixels a degree are not within 1 to {}", pixels_per_degree, kMaxPixelsPerDegree));
  }
  const cv::Matx33f xyz_from_rgb = relative_xyz_from_rgb();
  const Planes a = opponent_planes(image, xyz_from_rgb), b = opponent_planes(reference, xyz_from_rgb);
  cv::Mat error = color_difference(perceived(a, xyz_from_rgb, pixels_per_degree),
                                   perceived(b, xyz_from_rgb, pixels_per_degree), xyz_from_rgb);
  const cv::Mat feature = feature_difference(a[0], b[0], pixels_per_degree);
  for (int row = 0; row < error.rows; ++row) {
    auto* to = error.ptr<float>(row);
    const auto* exponent = feature.ptr<float>(row);
    for (int col = 0; col < error.cols; ++col) to[col] = std::pow(to[col], 1 - exponent[col]);
  }
  const double mean = cv::mean(error)[0];
  if (map != nullptr) *map = error;
  return mean;
}

}  // namespace splatbus::metrics
