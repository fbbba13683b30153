#include "bench/census.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

namespace splatbus::bench {
namespace {

constexpr std::uint32_t kTileSide = 16;

/// Looks along +z from the origin, so that depth is z.
Camera camera_of(std::uint32_t width, std::uint32_t height) {
  Camera camera;
  camera.width = width;
  camera.height = height;
  camera.fx = camera.fy = 100;
  camera.cx = 0.5F * static_cast<float>(width);
  camera.cy = 0.5F * static_cast<float>(height);
  return camera;
}

struct Ball {
  float x, y, z, radius, opacity_logit;
};

GaussiansBuffer model_of(const std::vector<Ball>& balls) {
  GaussiansBuffer model({Appearance::Radiance, 0}, balls.size());
  for (std::size_t i = 0; i < balls.size(); ++i) {
    const Ball& ball = balls[i];
    const float values[11] = {
        ball.x, ball.y, ball.z, std::log(ball.radius), std::log(ball.radius), std::log(ball.radius), 1,
        0,      0,      0,      ball.opacity_logit};
    for (std::size_t c = 0; c < 11; ++c) model.parameters[c * model.stride() + i] = values[c];
  }
  return model;
}

Census census_of(const std::vector<Ball>& balls, const Camera& camera) {
  const GaussiansBuffer model = model_of(balls);
  return take_census(model.view(), {&camera, 1}, kTileSide, {.antialias = false});
}

TEST(Census, AGaussianIsEvaluatedWhereItsAlphaReachesOneIn255) {
  const Camera camera = camera_of(64, 48);
  // On the axis a ball's picture is round: covariance (f r / z)^2 + blur, opacity 1/2.
  const float radius = 0.07F, z = 2;
  const Census census = census_of({{0, 0, z, radius, 0}}, camera);
  const double variance = std::pow(100.0 * radius / z, 2) + 0.3;
  double expected = 0;
  for (int y = 0; y < 48; ++y) {
    for (int x = 0; x < 64; ++x) {
      const double d2 = std::pow(x + 0.5 - 32, 2) + std::pow(y + 0.5 - 24, 2);
      if (0.5 * std::exp(-0.5 * d2 / variance) >= 1.0 / 255) ++expected;
    }
  }
  ASSERT_GT(expected, 300);
  EXPECT_EQ(census.evaluations, expected);
  EXPECT_EQ(census.pixels, 64 * 48);
  EXPECT_EQ(census.listed_records, 1);
  EXPECT_EQ(census.blended_records, 1);
}

TEST(Census, WhatLiesBehindOpaqueLayersIsListedButNotBlended) {
  const Camera camera = camera_of(40, 20);
  // Alpha is 0.999 all over the picture: after two of them a pixel is opaque.
  const Census census = census_of({{0, 0, 4, 100, 50}, {0, 0, 2, 100, 50}, {0, 0, 3, 100, 50}}, camera);
  EXPECT_EQ(census.listed_records, 3);
  EXPECT_EQ(census.pairs, 3 * 3 * 2);
  EXPECT_EQ(census.evaluations, 2 * 40 * 20);
  EXPECT_EQ(census.blended_records, 2);
  EXPECT_EQ(census.blended_pairs, 2 * 3 * 2);
}

TEST(Census, WhatCannotBeSeenIsNotListed) {
  const Camera camera = camera_of(64, 64);
  const Census census = census_of({{0, 0, -2, 0.1F, 0}, {50, 0, 2, 0.1F, 0}, {0, 0, 2, 0.1F, -8}}, camera);
  EXPECT_EQ(census.gaussians, 3);
  EXPECT_EQ(census.listed_records, 0);
  EXPECT_EQ(census.listed_gaussians, 0);
  EXPECT_EQ(census.evaluations, 0);
}

TEST(Census, PairsAreTilesWithAPixelOfTheGaussian) {
  const Camera camera = camera_of(64, 64);
  // About 3 pixels of radius: on the corner of four tiles, then in the middle of one.
  EXPECT_EQ(census_of({{0, 0, 2, 0.02F, 0}}, camera).pairs, 4);
  EXPECT_EQ(census_of({{0.16F, 0.16F, 2, 0.02F, 0}}, camera).pairs, 1);
}

TEST(Census, ABatchHasRecordsAViewAndGaussiansOnce) {
  const std::vector<Camera> cameras = {camera_of(32, 32), camera_of(32, 32), camera_of(64, 32)};
  const GaussiansBuffer model = model_of({{0, 0, 2, 0.05F, 0}, {0.2F, 0, 2, 0.05F, 0}});
  const Census census = take_census(model.view(), cameras, kTileSide);
  EXPECT_EQ(census.views, 3);
  EXPECT_EQ(census.pixels, 4 * 32 * 32);
  EXPECT_EQ(census.listed_records, 6);
  EXPECT_EQ(census.listed_gaussians, 2);
  EXPECT_EQ(census.blended_gaussians, 2);
}

TEST(Census, TheMeanIsOverAllBatchesOfTheRing) {
  const std::vector<Camera> cameras = {camera_of(32, 32), camera_of(16, 32), camera_of(64, 32)};
  const GaussiansBuffer model = model_of({{0, 0, 2, 0.05F, 0}});
  const Census mean = mean_census(model.view(), cameras, 2, kTileSide);
  EXPECT_EQ(mean.views, 2);
  EXPECT_DOUBLE_EQ(mean.pixels, 2.0 * (32 + 16 + 64) * 32 / 3);
}

TEST(Census, BlendsThoseThatTheRasteriserBlends) {
  std::mt19937 generator(3);
  const auto uniform = [&](float low, float high) {
    return low + (high - low) * static_cast<float>(generator() >> 8U) / 16777216.0F;
  };
  std::vector<Ball> balls(2000);
  for (Ball& ball : balls) {
    ball = {uniform(-1, 1), uniform(-1, 1), uniform(1, 4), uniform(0.02F, 0.2F), uniform(-6, 6)};
  }
  GaussiansBuffer model = model_of(balls);
  for (std::size_t c = 3; c < 10; ++c) {
    for (std::size_t i = 0; i < balls.size(); ++i) model.parameters[c * model.stride() + i] += uniform(-0.5F, 0.5F);
  }
  const Camera camera = camera_of(70, 50);
  const auto rasterizer = raster::make_cpu_rasterizer(1);
  raster::Render render;
  rasterizer->forward(model.view(), camera, {}, {}, render);
  raster::RenderGradient gradient;
  gradient.color = raster::Image(70, 50, 3);
  std::fill(gradient.color.data.begin(), gradient.color.data.end(), 1.0F);
  raster::ParameterGradient out;
  out.clear(model.view(), 1);
  rasterizer->backward(gradient, out);
  const auto touched = static_cast<double>(std::count(out.touched.begin(), out.touched.end(), std::uint8_t{1}));

  const Census census = take_census(model.view(), {&camera, 1}, kTileSide);
  ASSERT_LT(census.blended_records, census.listed_records);
  EXPECT_NEAR(census.blended_records, touched, 2);  // an exponential's last place decides a few
}

}  // namespace
}  // namespace splatbus::bench
