// Pages that are drawn and do not train, and what a picture shows of a page.
#include <gtest/gtest.h>

#include <cmath>

#include "../gaussians/paged_model.h"
#include "raster/adam.h"
#include "scenes.h"

namespace splatbus::raster {
namespace {

using test::PagedModel;
using testing::TestScene;

class FrozenTest : public ::testing::TestWithParam<ParameterLayout> {
 protected:
  FrozenTest() {
    for (std::size_t r = 0; r < paged.ranges.size(); r += 2) paged.ranges[r].frozen = 1;
    rasterizer->forward(paged.view(), camera, scene.state, {.depth = true}, picture);
    gradient = {.color = picture.color, .alpha = picture.alpha, .albedo = {}, .depth = picture.depth};
  }
  static bool is_frozen(const PagedModel& model, std::uint32_t i) {
    for (const IndexRange& range : model.ranges) {
      if (i >= range.first && i < range.first + range.count) return range.frozen != 0;
    }
    return false;
  }

  TestScene scene = testing::random_scene(GetParam(), 3000, {.scale_high = 0.15F}, 5);
  PagedModel paged{scene.view(), 300};
  PagedModel moving{scene.view(), 300};
  Camera camera = testing::test_camera(70, 50);
  std::unique_ptr<Rasterizer> rasterizer = make_cpu_rasterizer(2);
  Render picture;
  RenderGradient gradient;
};

TEST_P(FrozenTest, OthersGetTheGradientsThatTheyWouldHaveGot) {
  const auto other = make_cpu_rasterizer(2);
  Render same;
  other->forward(moving.view(), camera, scene.state, {.depth = true}, same);
  ASSERT_EQ(picture.color.data, same.color.data);
  ParameterGradient ours, theirs;
  ours.clear(paged.view());
  theirs.clear(moving.view());
  rasterizer->backward(gradient, ours);
  other->backward(gradient, theirs);
  std::size_t compared = 0;
  paged.for_each([&](std::uint32_t i, std::size_t) {
    const bool rests = is_frozen(paged, i);
    for (std::size_t c = 0; c < static_cast<std::size_t>(GetParam().channels()); ++c) {
      const float expected = rests ? 0.0F : theirs.values[c * theirs.stride + i];
      ASSERT_EQ(ours.values[c * ours.stride + i], expected) << c;
      compared += expected != 0 ? 1 : 0;
    }
    ASSERT_TRUE(rests || ours.contribution[i] == theirs.contribution[i]);
  });
  EXPECT_GT(compared, 1000U);
}

TEST_P(FrozenTest, AStepLeavesThemAsTheyAre) {
  const std::vector<float> before = paged.memory;
  const std::vector<float> rates(static_cast<std::size_t>(GetParam().channels()), 0.01F);
  ParameterGradient statistics;
  statistics.clear_statistics(paged.view());
  Adam adam;
  adam.resize(GetParam(), paged.view().count);
  rasterizer->backward_step(gradient, rates, adam, paged.memory.data(), statistics);
  ParameterGradient whole;
  whole.clear(paged.view());
  std::fill(whole.touched.begin(), whole.touched.end(), std::uint8_t{1});
  std::fill(whole.values.begin(), whole.values.end(), 1.0F);
  adam.step(paged.view(), paged.memory.data(), whole, rates, 2);
  std::size_t moved = 0;
  paged.for_each([&](std::uint32_t i, std::size_t) {
    const std::size_t offset = paged.view().offset(i);
    for (std::size_t c = 0; c < paged.channels; ++c) {
      const bool same = before[offset + c * kPageLanes] == paged.memory[offset + c * kPageLanes];
      ASSERT_TRUE(same || !is_frozen(paged, i));
      moved += same ? 0 : 1;
    }
  });
  EXPECT_GT(moved, 1000U);
  // And no page of them has room for moments.
  std::size_t pages = 0;
  for (const IndexRange& range : paged.ranges) pages += range.frozen == 0 ? 1 : 0;
  EXPECT_EQ(adam.block_bytes(), pages * (2 * paged.channels + 3) * kRowWords * sizeof(float));
}

INSTANTIATE_TEST_SUITE_P(Layouts, FrozenTest,
                         ::testing::Values(testing::transfer_layout(), testing::radiance_layout(2)),
                         [](const auto& of) {
                           return of.param.appearance == Appearance::Transfer ? "Transfer" : "Radiance";
                         });

TEST(ParameterGradient, ClearingForgetsWhatTheLastStepWrote) {
  TestScene scene = testing::random_scene(testing::radiance_layout(0), 900, {}, 4);
  PagedModel paged(scene.view(), 300);
  const auto rasterizer = make_cpu_rasterizer(1);
  Render picture;
  rasterizer->forward(paged.view(), testing::test_camera(40, 30), scene.state, {}, picture);
  ParameterGradient gradient;
  gradient.clear(paged.view());
  rasterizer->backward({.color = picture.color, .alpha = {}, .albedo = {}, .depth = {}}, gradient);
  ASSERT_GT(std::count(gradient.touched.begin(), gradient.touched.end(), 1), 100);
  gradient.clear_statistics(paged.view());
  EXPECT_EQ(std::count(gradient.touched.begin(), gradient.touched.end(), 0), static_cast<long>(paged.view().count));
  for (const float value : gradient.contribution) ASSERT_EQ(value, 0);
  for (const float value : gradient.mean2d_norm) ASSERT_EQ(value, 0);
}

/// Opaque discs that face the camera, each in a page of its own.
struct Discs {
  TestScene scene{testing::radiance_layout(0), 4};
  Camera camera = look_at({0, 0, 4}, {0, 0, 0}, 64, 64, 0.9F);

  Discs() {
    place(0, {-0.8F, 0, 0}, 0.02F);
    place(1, {0.9F, 0, 0}, 0.02F);
    place(2, {0.9F, 0, 1}, 0.1F);
    place(3, {-30, 0, 0}, 0.02F);  // outside of the picture
    for (std::uint32_t i = 0; i < 4; ++i) scene.object_id[i] = i + 1;
    for (std::uint32_t i = 0; i < 4; ++i) scene.state.objects[i + 1] = ObjectTransform();
  }
  void place(std::size_t i, glm::vec3 mean, float scale) {
    for (int c = 0; c < 3; ++c) scene.at(c, i) = mean[c];
    for (int c = 3; c < 6; ++c) scene.at(c, i) = std::log(scale);
    scene.at(6, i) = 1;
    scene.at(10, i) = 9;
  }
};

TEST(PageLooks, AreOfTheTilesThatAPageShowsIn) {
  Discs discs;
  PagedModel paged(discs.scene.view(), 10);
  ASSERT_EQ(paged.ranges.size(), 4U);
  const auto rasterizer = make_cpu_rasterizer(1);
  Render picture;
  rasterizer->forward(paged.view(), discs.camera, discs.scene.state, {}, picture);
  Image error(64, 64, 1);
  const auto looks = [&] {
    std::vector<PageLook> result;
    rasterizer->look_at_pages(error, result);
    return result;
  };
  std::fill(error.data.begin(), error.data.end(), 0.25F);
  auto seen = looks();
  ASSERT_EQ(seen.size(), 3U) << "one is outside";
  for (std::size_t k = 0; k < 3; ++k) {
    EXPECT_EQ(seen[k].page, k);
    EXPECT_DOUBLE_EQ(seen[k].error, 0.25);
  }
  // The first is at x = 32 - 0.8 / 4 fx: a tile or two there, and none in the right half.
  for (std::uint32_t y = 0; y < 64; ++y) {
    for (std::uint32_t x = 0; x < 64; ++x) error.data[y * 64 + x] = x < 32 ? 1.0F : 0.0F;
  }
  seen = looks();
  EXPECT_EQ(seen[0].error, 1);
  EXPECT_EQ(seen[1].error, 0);
  EXPECT_EQ(seen[2].error, 0);
  // A pixel that does not count takes no part in a tile's mean.
  for (std::uint32_t y = 0; y < 64; ++y) {
    for (std::uint32_t x = 0; x < 64; ++x) error.data[y * 64 + x] = x % 2 == 0 ? 0.5F : (x % 4 == 1 ? -1.0F : NAN);
  }
  EXPECT_DOUBLE_EQ(looks()[0].error, 0.5);
  std::fill(error.data.begin(), error.data.end(), -1.0F);
  EXPECT_TRUE(looks().empty());
}

TEST(PageLooks, WhatIsHiddenDoesNotShow) {
  Discs discs;
  TestScene& scene = discs.scene;
  // Forty sheets of alpha 0.999 before everything.
  TestScene walled(scene.layout, 44);
  walled.state = scene.state;
  for (std::size_t i = 0; i < 44; ++i) {
    for (int c = 0; c < scene.layout.channels(); ++c) walled.at(c, i) = scene.at(c, std::min<std::size_t>(i, 3));
    walled.object_id[i] = i < 4 ? static_cast<std::uint32_t>(i) + 1 : 9;
    if (i < 4) continue;
    walled.at(0, i) = 0;
    walled.at(2, i) = 2;
    for (int c = 3; c < 6; ++c) walled.at(c, i) = std::log(3.0F);
  }
  walled.state.objects[9] = ObjectTransform();
  PagedModel paged(walled.view(), 50);
  const auto rasterizer = make_cpu_rasterizer(1);
  Render picture;
  rasterizer->forward(paged.view(), discs.camera, walled.state, {}, picture);
  const Image error(64, 64, 1);
  std::vector<PageLook> seen;
  rasterizer->look_at_pages(error, seen);
  ASSERT_EQ(seen.size(), 1U);
  EXPECT_EQ(seen[0].page, paged.ranges.back().first / kPageLanes);
}

TEST(Adam, APageThatRestsGivesItsMomentsBackAndGoesOnAtItsAge) {
  TestScene scene = testing::random_scene(testing::radiance_layout(0), 40, {.objects = false}, 1);
  PagedModel paged(scene.view(), 100);
  Adam adam;
  adam.lr_half_life_steps = 10;
  adam.lr_min_factor = 0;
  const std::vector<float> rates(14, 0.1F);
  adam.resize(scene.layout, paged.view().count);
  ParameterGradient gradient;
  gradient.clear(paged.view());
  std::fill(gradient.touched.begin(), gradient.touched.end(), std::uint8_t{1});
  std::fill(gradient.values.begin(), gradient.values.end(), 2.0F);
  const auto step = [&] { adam.step(paged.view(), paged.memory.data(), gradient, rates, 1); };
  for (int k = 0; k < 90; ++k) step();
  ASSERT_GT(adam.block_bytes(), 0U);
  paged.ranges[0].frozen = 1;
  adam.keep(paged.ranges);
  EXPECT_EQ(adam.block_bytes(), 0U);
  paged.ranges[0].frozen = 0;
  adam.keep(paged.ranges);
  const float before = *paged.view().at(3, 7);
  step();
  // First moment 0.1 g with a bias of 1 - 0.9^91, second g^2, age 91.
  const float expected = 0.1F * 0.1F / (1 - std::pow(0.9F, 91.0F)) * 10 / (10 + 91);
  EXPECT_NEAR(before - *paged.view().at(3, 7), expected, 0.01F * expected);
  // What is no page any more is forgotten, and begins anew.
  adam.keep({});
  EXPECT_EQ(adam.block_bytes(), 0U);
  const float again = *paged.view().at(3, 7);
  step();
  EXPECT_NEAR(again - *paged.view().at(3, 7), 0.1F * 10 / 11, 1e-4F);
}

TEST(Adam, WhatMovesOutOfARestingPageTakesItsAgeAlong) {
  TestScene scene = testing::random_scene(testing::radiance_layout(0), 40, {.objects = false}, 1);
  PagedModel paged(scene.view(), 20);
  ASSERT_EQ(paged.ranges.size(), 2U);
  Adam adam;
  adam.lr_half_life_steps = 10;
  const std::vector<float> rates(14, 0.1F);
  adam.resize(scene.layout, paged.view().count);
  ParameterGradient gradient;
  gradient.clear(paged.view());
  std::fill(gradient.values.begin(), gradient.values.end(), 2.0F);
  std::fill_n(gradient.touched.begin(), 20, std::uint8_t{1});
  const auto step = [&] { adam.step(paged.view(), paged.memory.data(), gradient, rates, 1); };
  for (int k = 0; k < 50; ++k) step();
  paged.ranges[0].frozen = 1;
  adam.keep(paged.ranges);
  const std::uint32_t from = 3, to = kPageLanes + 5;
  adam.move({&from, 1}, {&to, 1});
  adam.keep(paged.ranges);
  std::fill(gradient.touched.begin(), gradient.touched.end(), std::uint8_t{1});
  const float before = *paged.view().at(3, to), beside = *paged.view().at(3, to + 1);
  step();
  const float expected = 0.1F * 0.1F / (1 - std::pow(0.9F, 51.0F)) * 10 / (10 + 51);
  EXPECT_NEAR(before - *paged.view().at(3, to), expected, 0.01F * expected);
  EXPECT_NEAR(beside - *paged.view().at(3, to + 1), 0.1F * 10 / 11, 1e-4F);
}

}  // namespace
}  // namespace splatbus::raster
