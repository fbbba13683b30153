// The far field goes with whoever looks: where he stands changes nothing, and where he looks everything.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

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

}  // namespace
}  // namespace splatbus::raster
