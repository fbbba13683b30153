#include "metrics/image_io.h"

#include <fmt/format.h>
#include <png.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <fstream>
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

/// Of libpng's simplified interface, which says what was wrong in place of jumping.
class Png {
 public:
  explicit Png(std::string what) : what_(std::move(what)) { image.version = PNG_IMAGE_VERSION; }
  Png(const Png&) = delete;
  Png& operator=(const Png&) = delete;
  ~Png() { png_image_free(&image); }

  void require(int succeeded) const {
    if (succeeded == 0) throw std::runtime_error(fmt::format("{}: {}", what_, image.message));
  }

  png_image image{};

 private:
  std::string what_;
};

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

std::vector<std::uint8_t> encode_png(const cv::Mat& bgr) {
  if (bgr.empty() || (bgr.type() != CV_8UC3 && bgr.type() != CV_8UC1)) {
    throw std::runtime_error("only pictures of type CV_8UC1 or CV_8UC3 can be written as PNG");
  }
  Png png("the PNG encoder failed");
  png.image.width = static_cast<png_uint_32>(bgr.cols);
  png.image.height = static_cast<png_uint_32>(bgr.rows);
  png.image.format = bgr.channels() == 3 ? PNG_FORMAT_BGR : PNG_FORMAT_GRAY;
  png.image.flags = PNG_IMAGE_FLAG_FAST;
  const cv::Mat rows = bgr.isContinuous() ? bgr : bgr.clone();
  png_alloc_size_t bytes = PNG_IMAGE_PNG_SIZE_MAX(png.image);
  std::vector<std::uint8_t> file(bytes);
  png.require(png_image_write_to_memory(&png.image, file.data(), &bytes, 0, rows.data, 0, nullptr));
  file.resize(bytes);
  return file;
}

void write_png(const std::string& path, const cv::Mat& image) {
  std::vector<std::uint8_t> bytes;
  try {
    bytes = encode_png(image);
  } catch (const std::runtime_error& error) {
    throw std::runtime_error(fmt::format("{}: {}", path, error.what()));
  }
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
  Png png(path + ": cannot be read as a picture");
  png.require(png_image_begin_read_from_file(&png.image, path.c_str()));
  if (png.image.width > kMaxSide || png.image.height > kMaxSide) {
    throw std::runtime_error(
        fmt::format("{}: {}x{} is more than {} a side", path, png.image.width, png.image.height, kMaxSide));
  }
  png.image.format = PNG_FORMAT_BGR;
  cv::Mat image(static_cast<int>(png.image.height), static_cast<int>(png.image.width), CV_8UC3, cv::Scalar::all(0));
  png.require(png_image_finish_read(&png.image, nullptr, image.data, 0, nullptr));
  return image;
}

}  // namespace splatbus::metrics
