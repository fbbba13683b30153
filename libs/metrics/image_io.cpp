#include "metrics/image_io.h"

#include <fmt/format.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <stdexcept>
#include <vector>

#include "gaussians/light.h"

namespace splatbus::metrics {
namespace {

constexpr std::uint32_t kMaxSide = 16384;

void check_pixels(const char* who, const void* pixels, std::uint32_t width, std::uint32_t height) {
  if (pixels == nullptr) throw std::invalid_argument(fmt::format("{}: no pixels", who));
  if (width == 0 || height == 0 || width > kMaxSide || height > kMaxSide) {
    throw std::invalid_argument(fmt::format("{}: {}x{} is not within 1 to {} a side", who, width, height, kMaxSide));
  }
}

}  // namespace

cv::Mat from_rgba(const std::uint8_t* rgba, std::uint32_t width, std::uint32_t height) {
  check_pixels("from_rgba", rgba, width, height);
  cv::Mat out(static_cast<int>(height), static_cast<int>(width), CV_8UC3);
  for (int row = 0; row < out.rows; ++row) {
    const std::uint8_t* in = rgba + std::size_t{4} * width * static_cast<std::size_t>(row);
    auto* to = out.ptr<cv::Vec3b>(row);
    for (std::uint32_t col = 0; col < width; ++col, in += 4) to[col] = {in[2], in[1], in[0]};
  }
  return out;
}

cv::Mat from_planes(const float* planes, std::uint32_t width, std::uint32_t height, bool encode_srgb) {
  check_pixels("from_planes", planes, width, height);
  const std::size_t pixels = std::size_t{width} * height;
  cv::Mat out(static_cast<int>(height), static_cast<int>(width), CV_8UC3);
  auto* to = out.ptr<cv::Vec3b>(0);
  for (std::size_t color = 0; color < 3; ++color) {
    const float* plane = planes + color * pixels;
    for (std::size_t i = 0; i < pixels; ++i) {
      const float display = encode_srgb ? srgb_from_linear(plane[i]) : plane[i];
      // Written so that NaN takes the first branch.
      const float clamped = display > 0 ? std::min(display, 1.0F) : 0.0F;
      to[i][static_cast<int>(2 - color)] = cv::saturate_cast<std::uint8_t>(clamped * 255);
    }
  }
  return out;
}

void write_png(const std::string& path, const cv::Mat& image) {
  if (image.empty() || (image.type() != CV_8UC3 && image.type() != CV_8UC1)) {
    throw std::runtime_error(fmt::format("{}: only pictures of type CV_8UC1 or CV_8UC3 can be written", path));
  }
  std::vector<std::uint8_t> bytes;
  if (!cv::imencode(".png", image, bytes)) throw std::runtime_error(fmt::format("{}: the PNG encoder failed", path));
  const std::string partial = path + ".partial";
  std::ofstream file(partial, std::ios::binary | std::ios::trunc);
  file.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  file.close();
  if (!file || std::rename(partial.c_str(), path.c_str()) != 0) {
    const std::string reason = std::strerror(errno);
    (void)std::remove(partial.c_str());
    throw std::runtime_error(fmt::format("{}: cannot be written: {}", path, reason));
  }
}

cv::Mat read_png(const std::string& path) {
  cv::Mat image;
  try {
    image = cv::imread(path, cv::IMREAD_COLOR);
  } catch (const cv::Exception& error) {
    throw std::runtime_error(fmt::format("{}: cannot be read as a picture: {}", path, error.what()));
  }
  if (image.empty()) throw std::runtime_error(fmt::format("{}: cannot be read as a picture", path));
  return image;
}

}  // namespace splatbus::metrics
