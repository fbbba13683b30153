// The far field goes with whoever looks: where he stands changes nothing, and where he looks everything.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "raster/unmodelled.h"
#include "scenes.h"

namespace splatbus::raster {
namespace {

using testing::TestScene;

constexpr ParameterLayout kTransfer{};

/// A Gaussian of that colour in each direction, eight degrees wide.
TestScene far_dots(const std::vector<glm::vec3>& directions) {
  TestScene scene(kTransfer, directions.size());
  scene.state.light.sun_irradiance = glm::vec3(3);  // which must not matter
  scene.state.objects[kFarFieldFrame] = far_field();
  for (std::size_t i = 0; i < directions.size(); ++i) {
    for (int c = 0; c < 3; ++c) {
      scene.at(ParameterLayout::kMean + c, i) = kFarFieldCentre[c] + kFarFieldRadius * directions[i][c];
      scene.at(ParameterLayout::kLogScale + c, i) = std::log(kFarFieldRadius * 0.14F);
      scene.at(ParameterLayout::kAlbedo + c, i) = 0.2F + 0.2F * static_cast<float>(c);
    }
    scene.at(ParameterLayout::kRotation, i) = 1;
    scene.at(ParameterLayout::kOpacityLogit, i) = 4;
    scene.normal[i] = 1;
    scene.object_id[i] = kFarFieldFrame;
  }
  return scene;
}

Render picture(const TestScene& scene, const glm::vec3& eye, const glm::vec3& forward) {
  Render render;
  make_cpu_rasterizer(1)->forward(scene.view(), look_at(eye, eye + forward, 96, 64, 0.9F), scene.state, {.depth = true},
                                  render);
  return render;
}

TEST(FarField, IsTheSameFromEverywhere) {
  const glm::vec3 ahead = glm::normalize(glm::vec3(0.3F, 0.1F, -1));
  const TestScene scene = far_dots({ahead, glm::normalize(ahead + glm::vec3(0.1F, 0.05F, 0))});
  const Render here = picture(scene, {0, 0, 0}, ahead);
  for (const glm::vec3 eye : {glm::vec3{150, 2, -80}, glm::vec3{-3000, 40, 900}}) {
    const Render there = picture(scene, eye, ahead);
    for (std::size_t i = 0; i < here.color.data.size(); ++i) {
      ASSERT_NEAR(there.color.data[i], here.color.data[i], 1.0F / 255) << i;
    }
  }
}

TEST(FarField, ShowsWhereItsDirectionSaysInTheColourThatItEmits) {
  const glm::vec3 ahead = glm::normalize(glm::vec3(-0.2F, 0.4F, 0.7F));
  const TestScene scene = far_dots({ahead});
  const Render render = picture(scene, {12, 3, 4}, ahead);
  const std::size_t middle = 32 * 96 + 48;
  const float opacity = 1 / (1 + std::exp(-4.0F));
  for (std::size_t c = 0; c < 3; ++c) {
    const float emitted = opacity * (0.2F + 0.2F * static_cast<float>(c));
    EXPECT_NEAR(render.color.data[c * 96 * 64 + middle], emitted, 0.03F * emitted) << c;
  }
  EXPECT_NEAR(render.depth.data[middle], opacity * kFarFieldDistance_m, 20) << "behind everything else";
  const Render away = picture(scene, {12, 3, 4}, -ahead);
  EXPECT_EQ(*std::ranges::max_element(away.alpha.data), 0);
}

TEST(FarField, IsLeftOutOfTheOpacityOfWhatIsNear) {
  const glm::vec3 ahead(0, 0, -1);
  TestScene scene = far_dots({ahead, glm::normalize(glm::vec3(0.15F, 0, -1))});
  // Before the second of them, 3 m away.
  TestScene both(kTransfer, 3);
  both.state = scene.state;
  for (int c = 0; c < kTransfer.channels(); ++c) {
    for (std::size_t i = 0; i < 2; ++i) both.at(c, i) = scene.at(c, i);
  }
  const glm::vec3 near = 3.0F * glm::normalize(glm::vec3(0.15F, 0, -1));
  for (int c = 0; c < 3; ++c) {
    both.at(ParameterLayout::kMean + c, 2) = near[c];
    both.at(ParameterLayout::kLogScale + c, 2) = std::log(0.2F);
  }
  both.at(ParameterLayout::kRotation, 2) = 1;
  both.at(ParameterLayout::kOpacityLogit, 2) = 0;
  for (std::size_t i = 0; i < 3; ++i) both.normal[i] = 1;
  both.object_id = {kFarFieldFrame, kFarFieldFrame, 0};
  const auto rasterizer = make_cpu_rasterizer(1);
  Render render;
  rasterizer->forward(both.view(), look_at(glm::vec3(0), ahead, 96, 64, 0.9F), both.state, {}, render);
  std::vector<float> opacity;
  rasterizer->opacity_within(kNearerThanFarField_m, opacity);
  ASSERT_EQ(opacity.size(), 12U * 8 * 2);
  const float focal = 32 / std::tan(0.45F);
  for (std::size_t square = 0; square < 96; ++square) {
    for (int k = 0; k < kUnmodelledSamples; ++k) {
      const std::size_t x = square % 12 * 8 + unmodelled_sample(k), y = square / 12 * 8 + unmodelled_sample(k);
      // A round Gaussian's picture, by its angular width; off the middle it is a little wider.
      const float dx = (static_cast<float>(x) + 0.5F - 48) - 0.15F * focal, dy = static_cast<float>(y) + 0.5F - 32;
      const float sigma = 0.2F / 3 * focal;
      const float expected = 0.5F * std::exp(-0.5F * (dx * dx + dy * dy) / (sigma * sigma));
      EXPECT_NEAR(opacity[2 * square + static_cast<std::size_t>(k)], expected, 0.03F) << x << ' ' << y;
    }
  }
  EXPECT_GT(render.alpha.data[32 * 96 + 48], 0.9F) << "the far field shows there";
}

}  // namespace
}  // namespace splatbus::raster
