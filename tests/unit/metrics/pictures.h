#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdlib>
#include <opencv2/core.hpp>

// Pictures made by integer arithmetic, so that expected.py makes the very same: gradients, a chequerboard, a disc and
// two thin lines, and four ways to spoil them.
namespace splatbus::metrics::test {

constexpr int kWidth = 96, kHeight = 72;
using Rgb = std::array<int, 3>;

inline std::uint32_t hash32(int x, int y, int c) {
  const auto u = [](int v) { return static_cast<std::uint32_t>(v); };
  std::uint32_t h = u(x) * 374761393U + u(y) * 668265263U + u(c) * 2246822519U + 3266489917U;
  h = (h ^ (h >> 15U)) * 2246822519U;
  h = (h ^ (h >> 13U)) * 3266489917U;
  return h ^ (h >> 16U);
}

inline Rgb reference_at(int x, int y) {
  Rgb out = {x * 255 / (kWidth - 1), y * 255 / (kHeight - 1), (x + y) * 3 % 256};
  if ((x / 6 + y / 6) % 2 == 1) {
    for (int& value : out) value = value * 3 / 4;
  }
  if ((x - 60) * (x - 60) + (y - 30) * (y - 30) < 18 * 18) out = {200, 60, 40};
  if (x - y == 10 || y == 50) out = {250, 250, 240};
  return out;
}

template <typename F>
cv::Mat picture(F&& rgb_at) {
  cv::Mat out(kHeight, kWidth, CV_8UC3);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const Rgb rgb = rgb_at(x, y);
      for (int c = 0; c < 3; ++c) {
        out.at<cv::Vec3b>(y, x)[2 - c] =
            static_cast<std::uint8_t>(std::clamp(rgb[static_cast<std::size_t>(c)], 0, 255));
      }
    }
  }
  return out;
}

inline cv::Mat reference() {
  return picture(reference_at);
}

inline cv::Mat noise() {
  return picture([](int x, int y) {
    Rgb out = reference_at(x, y);
    for (int c = 0; c < 3; ++c) out[static_cast<std::size_t>(c)] += static_cast<int>(hash32(x, y, c) % 49) - 24;
    return out;
  });
}

inline cv::Mat shift() {
  return picture([](int x, int y) { return reference_at(std::max(x - 2, 0), y); });
}

inline cv::Mat blur() {
  return picture([](int x, int y) {
    Rgb sum = {0, 0, 0};
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dx = -1; dx <= 1; ++dx) {
        const Rgb near = reference_at(std::clamp(x + dx, 0, kWidth - 1), std::clamp(y + dy, 0, kHeight - 1));
        for (std::size_t c = 0; c < 3; ++c) sum[c] += near[c];
      }
    }
    for (int& value : sum) value /= 9;
    return sum;
  });
}

inline cv::Mat tint() {
  return picture([](int x, int y) {
    const Rgb in = reference_at(x, y);
    return Rgb{in[0] * 10 / 8, in[1] * 7 / 8 + 6, in[2] - 9};
  });
}

}  // namespace splatbus::metrics::test
