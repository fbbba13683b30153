// A sky behind everything: infinitely far away, and no surface.
#include <gtest/gtest.h>

#include <set>

#include "toy_renderer.h"

namespace splatbus::sim {
namespace {

Renderer& under_clouds() {
  static Renderer renderer(shared_context(), [] {
    Scene scene = make_toys(1, false);
    scene.lighting.clouds = true;
    return scene;
  }());
  return renderer;
}

/// Looks over everything.
splatbus_camera at(const glm::vec3& eye, const glm::vec3& forward) {
  return look_at(eye, eye + forward, 96, 64, 60);
}

TEST(Sky, IsWhereTheDirectionSaysAndNowhereNearer) {
  Renderer& renderer = under_clouds();
  const std::vector<std::uint8_t> here = renderer.render(at({0, 30, 0}, {1, 0.3F, 0.2F}), kAll).color;
  const Pictures& there = renderer.render(at({-70, 55, 12}, {1, 0.3F, 0.2F}), kAll);
  ASSERT_EQ(there.color.size(), here.size());
  for (std::size_t i = 0; i < here.size(); ++i) ASSERT_NEAR(there.color[i], here[i], 2) << "but for rounding";
  std::set<std::uint8_t> tones;
  for (std::size_t i = 0; i < there.object_id.size(); ++i) {
    ASSERT_EQ(there.object_id[i], 0U);
    ASSERT_EQ(there.depth[i], 0);
    ASSERT_EQ(there.color[4 * i + 3], 0) << "coverage";
    ASSERT_EQ(there.albedo[4 * i], 0);
    tones.insert(there.color[4 * i]);
  }
  EXPECT_GT(tones.size(), 30U) << "there is something to see";
  EXPECT_NE(renderer.render(at({0, 30, 0}, {-1, 0.3F, 0.2F}), kAll).color, here);
}

TEST(Sky, LiesBehindTheToys) {
  const Pictures clouds = under_clouds().render(ring_camera(0.4F), kAll);
  const Pictures plain = Renderer(shared_context(), make_toys(1, false)).render(ring_camera(0.4F), kAll);
  ASSERT_EQ(clouds.object_id, plain.object_id);
  std::size_t behind = 0;
  for (std::size_t i = 0; i < plain.object_id.size(); ++i) {
    ASSERT_EQ(clouds.color[4 * i + 3], plain.color[4 * i + 3]);
    if (plain.color[4 * i + 3] == 255) {
      for (std::size_t c = 0; c < 3; ++c) ASSERT_EQ(clouds.color[4 * i + c], plain.color[4 * i + c]);
    } else if (plain.color[4 * i + 3] == 0) {
      behind += clouds.color[4 * i] != plain.color[4 * i] ? 1 : 0;
    }
  }
  EXPECT_GT(behind, 300U);
}

TEST(Sky, IsAsBrightAsTheLightsBackground) {
  Scene scene = make_toys(1, false);
  scene.lighting.clouds = true;
  scene.lighting.night = true;
  Renderer night(shared_context(), std::move(scene));
  const splatbus_camera camera = at({0, 30, 0}, {1, 0.3F, 0.2F});
  const auto mean = [&](Renderer& renderer) {
    const Pictures& pictures = renderer.render(camera, kAll);
    double sum = 0;
    for (std::size_t i = 0; i < pictures.color.size(); i += 4)
      sum += double{linear_from_srgb(static_cast<float>(pictures.color[i]) / 255)};
    return sum / static_cast<double>(pictures.color.size() / 4);
  };
  const double share = mean(night) / mean(under_clouds());
  const double expected =
      double{night.instant().light.background[0]} / double{under_clouds().instant().light.background[0]};
  EXPECT_NEAR(share, expected, 0.15 * expected + 0.002);
}

}  // namespace
}  // namespace splatbus::sim
