#pragma once

#include <cstdint>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

namespace splatbus::metrics {

/// A CV_8UC3 BGR copy of interleaved RGBA8 under the sRGB curve, as engines send it, row 0 on top; alpha is
/// dropped. Throws std::invalid_argument on a null pointer or a side that is zero or over 16384.
[[nodiscard]] cv::Mat from_rgba(const std::uint8_t* rgba, std::uint32_t width, std::uint32_t height);

/// A CV_8UC3 BGR picture of three float planes R, G, B of width * height each, clamped to [0, 1] (NaN is 0), rounded to
/// nearest. `encode_srgb`: the planes are linear light and go under the sRGB curve; otherwise they are display space.
[[nodiscard]] cv::Mat from_planes(const float* planes, std::uint32_t width, std::uint32_t height, bool encode_srgb);

/// The bytes of a PNG file of CV_8UC1 or CV_8UC3 BGR. Throws std::runtime_error.
[[nodiscard]] std::vector<std::uint8_t> encode_png(const cv::Mat& bgr);

/// CV_8UC1 or CV_8UC3 BGR to a PNG file, written beside it and renamed, so that a reader never meets half a file.
/// Throws std::runtime_error naming the path.
void write_png(const std::string& path, const cv::Mat& image);

/// CV_8UC3 BGR, whatever the PNG file holds; what is transparent lies on black. Throws std::runtime_error naming the
/// path.
[[nodiscard]] cv::Mat read_png(const std::string& path);

}  // namespace splatbus::metrics
