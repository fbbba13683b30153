// What a picture shows of a page.
#include <gtest/gtest.h>

#include <cmath>

#include "../gaussians/paged_model.h"
#include "walled_scene.h"

namespace splatbus::raster {
namespace {

using test::PagedModel;
using testing::Wall;
using testing::WalledScene;

constexpr int kLooksForAll = 64;  // of which each blends another pixel of a tile

class PageLooksTest : public ::testing::TestWithParam<Wall> {
 protected:
  PageLooksTest() { rasterizer->forward(paged.view(), scene.camera, scene.scene.state, {}, picture); }

  testing::LookSums look(const Image& error, int looks = kLooksForAll) {
    testing::LookSums sums;
    std::vector<PageLook> seen;
    for (int k = 0; k < looks; ++k) {
      rasterizer->look_at_pages(error, seen);
      sums.add(seen, paged.ranges);
    }
    return sums;
  }
  template <class Error>
  [[nodiscard]] Image image_of(const Error& error) const {
    Image image(scene.camera.width, scene.camera.height, 1);
    for (std::uint32_t y = 0; y < image.height; ++y) {
      for (std::uint32_t x = 0; x < image.width; ++x) {
        image.data[y * image.width + x] = static_cast<float>(error(x, y));
      }
    }
    return image;
  }

  WalledScene scene{GetParam()};
  PagedModel paged{scene.scene.view(), kPageLanes};
  std::unique_ptr<Rasterizer> rasterizer = make_cpu_rasterizer(1);
  Render picture;
};

TEST_P(PageLooksTest, AreThePixelsThatAPageMakesUpAndTheirErrors) {
  const auto error = [](std::uint32_t x, std::uint32_t) { return x < 48 ? 0.25 : 0.5; };
  testing::expect_true(look(image_of(error)), scene, GetParam(), error);
}

TEST_P(PageLooksTest, WhatDoesNotCountTakesNoPart) {
  const auto error = [](std::uint32_t x, std::uint32_t y) { return (x + y) % 3 == 0 ? -1.0 : x < 64 ? 0.25 : 0.5; };
  Image image = image_of(error);
  for (float& value : image.data) value = value < 0 && &value - image.data.data() > 900 ? NAN : value;
  testing::expect_true(look(image), scene, GetParam(), error);
  EXPECT_TRUE(look(image_of([](auto, auto) { return -1; }), 2).weight_px.empty());
}

INSTANTIATE_TEST_SUITE_P(Walls, PageLooksTest, ::testing::Values(Wall::None, Wall::Opaque, Wall::Leaky),
                         [](const auto& of) {
                           return of.param == Wall::None ? "None" : of.param == Wall::Opaque ? "Opaque" : "Leaky";
                         });

}  // namespace
}  // namespace splatbus::raster
