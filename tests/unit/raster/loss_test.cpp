#include "raster/loss.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "gaussians/light.h"

namespace splatbus::raster {
namespace {

std::vector<std::uint8_t> random_target(std::size_t pixels) {
  std::mt19937 generator(2);
  std::vector<std::uint8_t> target(4 * pixels);
  for (std::uint8_t& value : target) value = static_cast<std::uint8_t>(generator() >> 24U);
  return target;
}

TEST(Loss, OfThePictureItselfIsZero) {
  const std::vector<std::uint8_t> target = random_target(std::size_t{30} * 20);
  Image rendered(30, 20, 3), gradient;
  for (std::size_t i = 0; i < 600; ++i) {
    for (std::uint32_t c = 0; c < 3; ++c) {
      rendered.plane(c)[i] = linear_from_srgb(static_cast<float>(target[4 * i + c]) / 255);
    }
  }
  EXPECT_NEAR(image_loss(rendered, target.data(), {}, gradient), 0, 1e-5F);
}

/// In a picture of one band of rows and in one of several.
class LossGradient : public ::testing::TestWithParam<std::uint32_t> {};
INSTANTIATE_TEST_SUITE_P(Heights, LossGradient, ::testing::Values(19U, 75U));

TEST_P(LossGradient, IsTheSlope) {
  const std::uint32_t height = GetParam();
  const std::vector<std::uint8_t> target = random_target(std::size_t{23} * height);
  std::mt19937 generator(3);
  Image rendered(23, height, 3), gradient, scratch;
  for (float& value : rendered.data) value = 0.05F + 0.9F * static_cast<float>(generator() >> 8U) / 16777216.0F;
  (void)image_loss(rendered, target.data(), {}, gradient);
  for (std::size_t i = 0; i < rendered.data.size(); i += 97) {
    const float kept = rendered.data[i], h = 1e-3F;
    rendered.data[i] = kept + h;
    const float above = image_loss(rendered, target.data(), {}, scratch);
    rendered.data[i] = kept - h;
    const float below = image_loss(rendered, target.data(), {}, scratch);
    rendered.data[i] = kept;
    EXPECT_NEAR((above - below) / (2 * h), gradient.data[i], 1e-4F);
  }
}

TEST_P(LossGradient, OfMaskedPixelsIsZeroAndTheyAreInNobodysWindow) {
  const std::uint32_t width = 23, height = GetParam();
  const std::size_t pixels = std::size_t{width} * height;
  std::vector<std::uint8_t> target = random_target(pixels), mask(pixels);
  std::mt19937 generator(3);
  Image rendered(width, height, 3), gradient, scratch;
  for (float& value : rendered.data) value = 0.05F + 0.9F * static_cast<float>(generator() >> 8U) / 16777216.0F;
  for (std::size_t i = 0; i < pixels; ++i) mask[i] = i % width > 9 && i % width < 17 ? 1 + i % 255 : 0;
  const LossOptions options{.mask = mask.data()};
  const float loss = image_loss(rendered, target.data(), options, gradient);
  for (std::size_t i = 0; i < gradient.data.size(); i += 7) {
    if (mask[i % pixels] != 0) {
      EXPECT_EQ(gradient.data[i], 0);
      continue;
    }
    const float kept = rendered.data[i], h = 1e-3F;
    const float off = srgb_from_linear(kept) - static_cast<float>(target[4 * (i % pixels) + i / pixels]) / 255;
    if (std::abs(off) < 0.02F) continue;  // |x - y| has no slope at 0
    rendered.data[i] = kept + h;
    const float above = image_loss(rendered, target.data(), options, scratch);
    rendered.data[i] = kept - h;
    const float below = image_loss(rendered, target.data(), options, scratch);
    rendered.data[i] = kept;
    EXPECT_NEAR((above - below) / (2 * h), gradient.data[i], 1e-4F);
  }
  // Whatever the target shows there.
  for (std::size_t i = 0; i < pixels; ++i) {
    if (mask[i] != 0) std::fill_n(target.begin() + static_cast<std::ptrdiff_t>(4 * i), 4, std::uint8_t{255});
  }
  EXPECT_EQ(image_loss(rendered, target.data(), options, scratch), loss);
  EXPECT_EQ(scratch.data, gradient.data);
  EXPECT_GT(image_loss(rendered, target.data(), {}, scratch), loss);
}

TEST(Loss, OutsideTheRangeOnlyWhatLeadsBackInside) {
  std::vector<std::uint8_t> target(4, 128);
  Image rendered(1, 1, 3), gradient;
  const LossOptions l1{0, true};
  rendered.data = {-0.5F, 1.5F, 0.5F};
  (void)image_loss(rendered, target.data(), l1, gradient);
  EXPECT_LT(gradient.data[0], 0);  // up, towards the target
  EXPECT_GT(gradient.data[1], 0);  // down
  target = {0, 255, 128, 255};
  (void)image_loss(rendered, target.data(), l1, gradient);
  EXPECT_EQ(gradient.data[0], 0);
  EXPECT_EQ(gradient.data[1], 0);
}

TEST(Loss, EmptyPicture) {
  Image rendered(0, 0, 3), gradient;
  EXPECT_EQ(image_loss(rendered, nullptr, {}, gradient), 0);
  EXPECT_TRUE(gradient.data.empty());
}

TEST(L1Error, IsThatOfEachPixelInDisplaySpace) {
  Image rendered(2, 2, 3);
  const float values[4] = {0.2F, 1.7F, -0.5F, 0.03F};
  for (std::uint32_t c = 0; c < 3; ++c) std::copy_n(values, 4, rendered.plane(c));
  rendered.plane(1)[0] = 0.9F;
  std::vector<std::uint8_t> target(16, 51);
  const std::uint8_t mask[4] = {0, 0, 0, 9};
  const auto srgb = [](double x) { return x <= 0.0031308 ? 12.92 * x : 1.055 * std::pow(x, 1 / 2.4) - 0.055; };
  Image error;
  l1_error(rendered, target.data(), true, mask, error);
  EXPECT_NEAR(error.data[0], (2 * (srgb(0.2) - 0.2) + srgb(0.9) - 0.2) / 3, 1e-3);
  EXPECT_NEAR(error.data[1], 0.8, 1e-5);
  EXPECT_NEAR(error.data[2], 0.2, 1e-5);
  EXPECT_EQ(error.data[3], -1);
  l1_error(rendered, target.data(), false, nullptr, error);
  EXPECT_NEAR(error.data[0], 0.7 / 3, 1e-5);
  EXPECT_NEAR(error.data[3], 0.17, 1e-5);
}

}  // namespace
}  // namespace splatbus::raster
