#include "metrics/image_io.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <stdexcept>

#include "pictures.h"

namespace splatbus::metrics {
namespace {

using ::testing::HasSubstr;
using ::testing::ThrowsMessage;

class ImageFiles : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string pattern = (std::filesystem::temp_directory_path() / "splatbus-image-XXXXXX").string();
    ASSERT_NE(mkdtemp(pattern.data()), nullptr);
    directory_ = pattern;
  }
  void TearDown() override { std::filesystem::remove_all(directory_); }
  [[nodiscard]] std::string path(const char* name) const { return (directory_ / name).string(); }

 private:
  std::filesystem::path directory_;
};

TEST(ImageConversion, RgbaBecomesBgrAndLosesAlpha) {
  const std::array<std::uint8_t, 8> rgba = {1, 2, 3, 4, 250, 240, 230, 0};
  const cv::Mat image = from_rgba(rgba.data(), 1, 2);
  ASSERT_EQ(image.size(), cv::Size(1, 2));
  EXPECT_EQ(image.at<cv::Vec3b>(0, 0), cv::Vec3b(3, 2, 1));
  EXPECT_EQ(image.at<cv::Vec3b>(1, 0), cv::Vec3b(230, 240, 250));
}

TEST(ImageConversion, PlanesAreRedGreenBlue) {
  const std::array<float, 6> planes = {0.0F, 1.0F, 0.5F, -3.0F, std::nanf(""), 9.0F};
  const cv::Mat display = from_planes(planes.data(), 2, 1, false);
  EXPECT_EQ(display.at<cv::Vec3b>(0, 0), cv::Vec3b(0, 128, 0));
  EXPECT_EQ(display.at<cv::Vec3b>(0, 1), cv::Vec3b(255, 0, 255));
  const cv::Mat encoded = from_planes(planes.data(), 2, 1, true);
  EXPECT_EQ(encoded.at<cv::Vec3b>(0, 0), cv::Vec3b(0, 188, 0)) << "linear 0.5 is 187.5 under the sRGB curve";
  EXPECT_EQ(encoded.at<cv::Vec3b>(0, 1), cv::Vec3b(255, 0, 255));
}

TEST(ImageConversion, RefusesWhatIsNoPicture) {
  const std::array<std::uint8_t, 4> rgba{};
  EXPECT_THROW((void)from_rgba(nullptr, 1, 1), std::invalid_argument);
  EXPECT_THROW((void)from_rgba(rgba.data(), 0, 1), std::invalid_argument);
  EXPECT_THROW((void)from_rgba(rgba.data(), 1, 1U << 30U), std::invalid_argument);
  EXPECT_THROW((void)from_planes(nullptr, 1, 1, true), std::invalid_argument);
}

TEST_F(ImageFiles, PngKeepsEveryPixel) {
  const cv::Mat image = test::reference();
  write_png(path("picture.png"), image);
  EXPECT_EQ(cv::norm(read_png(path("picture.png")), image, cv::NORM_INF), 0);
  EXPECT_FALSE(std::filesystem::exists(path("picture.png.partial")));
  // As others have it, whatever lies between rows, and a picture of theirs.
  EXPECT_EQ(cv::norm(cv::imread(path("picture.png")), image, cv::NORM_INF), 0);
  const cv::Mat part = image(cv::Rect(3, 5, image.cols - 7, image.rows - 9));
  write_png(path("part.png"), part);
  EXPECT_EQ(cv::norm(cv::imread(path("part.png")), part, cv::NORM_INF), 0);
  cv::Mat grey;
  cv::extractChannel(image, grey, 1);
  write_png(path("grey.png"), grey);
  EXPECT_EQ(cv::norm(cv::imread(path("grey.png"), cv::IMREAD_GRAYSCALE), grey, cv::NORM_INF), 0);
  cv::imwrite(path("theirs.png"), image);
  EXPECT_EQ(cv::norm(read_png(path("theirs.png")), image, cv::NORM_INF), 0);
}

TEST_F(ImageFiles, ErrorsNameTheFile) {
  std::ofstream(path("broken.png")) << "\x89PNG\r\n\x1a\n and then nonsense";
  EXPECT_THAT([&] { (void)read_png(path("broken.png")); }, ThrowsMessage<std::runtime_error>(HasSubstr("broken.png")));
  EXPECT_THAT([&] { (void)read_png(path("none.png")); }, ThrowsMessage<std::runtime_error>(HasSubstr("none.png")));
  EXPECT_THAT([&] { write_png(path("no/such/folder.png"), test::reference()); },
              ThrowsMessage<std::runtime_error>(HasSubstr("folder.png")));
  EXPECT_THAT([&] { write_png(path("empty.png"), cv::Mat()); },
              ThrowsMessage<std::runtime_error>(HasSubstr("empty.png")));
}

}  // namespace
}  // namespace splatbus::metrics
