#include "metrics/metrics.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <stdexcept>

#include "pictures.h"

namespace splatbus::metrics {
namespace {

using ::testing::HasSubstr;
using ::testing::ThrowsMessage;

// Values of expected.py: PSNR and SSIM of scikit-image 0.19, FLIP of a transcription of the paper in double precision
// with two-dimensional filters. NVIDIA's own C++ implementation (NVlabs/flip, FLIP.h) gives the same means on these
// pictures within 2e-6 and the same pixels within 1e-5.
struct Expected {
  const char* name;
  cv::Mat (*picture)();
  double psnr_db, ssim, ssim_map_mean, flip_67, flip_30, flip_at_60_30, flip_at_0_0;
};

class AgainstOtherImplementations : public ::testing::TestWithParam<Expected> {};

TEST_P(AgainstOtherImplementations, Psnr) {
  EXPECT_NEAR(psnr(GetParam().picture(), test::reference()), GetParam().psnr_db, 1e-5);
}

TEST_P(AgainstOtherImplementations, Ssim) {
  cv::Mat map;
  EXPECT_NEAR(ssim(GetParam().picture(), test::reference(), &map), GetParam().ssim, 1e-5);
  ASSERT_EQ(map.type(), CV_32FC1);
  ASSERT_EQ(map.size(), cv::Size(test::kWidth, test::kHeight));
  EXPECT_NEAR(cv::mean(map)[0], GetParam().ssim_map_mean, 1e-5) << "borders are mirrored";
}

TEST_P(AgainstOtherImplementations, Flip) {
  cv::Mat map;
  EXPECT_NEAR(flip(GetParam().picture(), test::reference(), 67.0, &map), GetParam().flip_67, 2e-5);
  ASSERT_EQ(map.type(), CV_32FC1);
  EXPECT_NEAR(map.at<float>(30, 60), GetParam().flip_at_60_30, 5e-5);
  EXPECT_NEAR(map.at<float>(0, 0), GetParam().flip_at_0_0, 5e-5);
  EXPECT_NEAR(flip(GetParam().picture(), test::reference(), 30.0), GetParam().flip_30, 2e-5);
}

INSTANTIATE_TEST_SUITE_P(
    Metrics, AgainstOtherImplementations,
    ::testing::Values(
        Expected{"noise", test::noise, 25.300154, 0.695752, 0.687029, 0.114622, 0.214702, 0.109438, 0.155579},
        Expected{"shift", test::shift, 17.616833, 0.521833, 0.534158, 0.255360, 0.293506, 0.000080, 0.006560},
        Expected{"blur", test::blur, 21.910638, 0.773133, 0.788194, 0.123121, 0.193160, 0.000031, 0.016701},
        Expected{"tint", test::tint, 22.199915, 0.973777, 0.965168, 0.392730, 0.392498, 0.586017, 0.065608}),
    [](const auto& expected) { return std::string(expected.param.name); });

TEST(Metrics, EqualPicturesArePerfect) {
  const cv::Mat picture = test::reference();
  EXPECT_EQ(psnr(picture, picture.clone()), std::numeric_limits<double>::infinity());
  EXPECT_DOUBLE_EQ(ssim(picture, picture.clone()), 1.0);
  EXPECT_EQ(flip(picture, picture.clone()), 0.0);
}

TEST(Metrics, BlackAgainstWhite) {
  const cv::Mat black(32, 32, CV_8UC3, cv::Scalar::all(0)), white(32, 32, CV_8UC3, cv::Scalar::all(255));
  EXPECT_DOUBLE_EQ(psnr(black, white), 0.0);
  constexpr double kC1 = 6.5025;
  EXPECT_NEAR(ssim(black, white), kC1 / (255.0 * 255.0 + kC1), 1e-9);
  // Lightness differs by 100, hue by nothing: 0.95 + 0.05 (100^0.7 - 0.4 c) / (0.6 c), c = 41.276 (green against blue).
  const double largest = 41.2760;
  EXPECT_NEAR(flip(black, white), 0.95 + 0.05 * (std::pow(100, 0.7) - 0.4 * largest) / (0.6 * largest), 1e-4);
}

TEST(Metrics, FlipIsSymmetricAndItsMapStaysWithinItsRange) {
  cv::Mat forward, backward;
  const cv::Mat ref = test::reference(), shifted = test::shift();
  EXPECT_NEAR(flip(shifted, ref, 67.0, &forward), flip(ref, shifted, 67.0, &backward), 1e-7);
  double low = 0, high = 0;
  cv::minMaxLoc(forward, &low, &high);
  EXPECT_GE(low, 0.0);
  EXPECT_LE(high, 1.0);
  EXPECT_LT(cv::norm(forward, backward, cv::NORM_INF), 1e-6);
}

TEST(Metrics, CompareGivesAllThree) {
  const Quality quality = compare(test::noise(), test::reference());
  EXPECT_EQ(quality.psnr_db, psnr(test::noise(), test::reference()));
  EXPECT_EQ(quality.ssim, ssim(test::noise(), test::reference()));
  EXPECT_EQ(quality.flip, flip(test::noise(), test::reference()));
}

TEST(Metrics, PartsOfLargerPicturesCount) {
  const cv::Rect part(7, 5, 40, 30);
  const cv::Mat image = test::noise(), ref = test::reference();
  const Quality view = compare(image(part), ref(part));
  const Quality copy = compare(image(part).clone(), ref(part).clone());
  EXPECT_EQ(view.psnr_db, copy.psnr_db);
  EXPECT_EQ(view.ssim, copy.ssim);
  EXPECT_EQ(view.flip, copy.flip);
}

TEST(Metrics, MismatchesAreNamed) {
  const cv::Mat picture(32, 32, CV_8UC3), wide(32, 33, CV_8UC3), gray(32, 32, CV_8UC1), small(10, 32, CV_8UC3);
  const auto message = [](const char* text) { return ThrowsMessage<std::invalid_argument>(HasSubstr(text)); };
  EXPECT_THAT([&] { (void)psnr(picture, wide); }, message("psnr: the image is 32x32, the reference 33x32"));
  EXPECT_THAT([&] { (void)psnr(gray, picture); }, message("the image is not of type CV_8UC3"));
  EXPECT_THAT([&] { (void)flip(picture, cv::Mat()); }, message("flip: the reference is empty"));
  EXPECT_THAT([&] { (void)ssim(small, small); }, message("sides must be at least 11"));
  EXPECT_THAT([&] { (void)flip(picture, picture, std::nan("")); }, message("pixels a degree"));
  EXPECT_THAT([&] { (void)flip(picture, picture, 1e9); }, message("pixels a degree"));
}

TEST(Colorize, RunsFromBlackOverRedToLightYellow) {
  cv::Mat map = (cv::Mat_<float>(1, 5) << 0.0F, 0.5F, 1.0F, 7.0F, std::nanf(""));
  const cv::Mat colors = colorize(map);
  ASSERT_EQ(colors.type(), CV_8UC3);
  // First, middle and last entry of matplotlib's magma: (0.001462, 0.000466, 0.013866), (0.716387, 0.214982, 0.475290)
  // and (0.987053, 0.991438, 0.749504), R G B.
  const auto expect_rgb = [&colors](int column, int r, int g, int b) {
    const auto& bgr = colors.at<cv::Vec3b>(0, column);
    EXPECT_NEAR(bgr[2], r, 2);
    EXPECT_NEAR(bgr[1], g, 2);
    EXPECT_NEAR(bgr[0], b, 2);
  };
  expect_rgb(0, 0, 0, 4);
  expect_rgb(1, 183, 55, 121);
  expect_rgb(2, 252, 253, 191);
  expect_rgb(3, 252, 253, 191);
  expect_rgb(4, 0, 0, 4);
  EXPECT_THROW((void)colorize(colors), std::invalid_argument);
}

}  // namespace
}  // namespace splatbus::metrics
