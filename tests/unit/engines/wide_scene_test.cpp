// The sun's shadows in a scene of 200 m.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <vector>

#include "sim/field.h"
#include "toy_renderer.h"

namespace splatbus::sim {
namespace {

/// The sun stands at 45 degrees over +z, so that the near post's shadow is 10 cm wide and ends 1.5 m behind it. What
/// could reach that place otherwise is not there.
Scene field() {
  Scene scene = make_field(1);
  std::erase_if(scene.objects, [](const Object& object) {
    return object.id > 2 && glm::length(glm::vec3(object.world_from_object[3]) - glm::vec3(1, 0, -1)) < 5;
  });
  scene.lighting.sun_azimuth_deg = 90;
  scene.lighting.sun_zenith_deg = 45;
  return scene;
}

/// Albedo aside, how much of the sun arrives at a pixel of the field: 1, or 0 in a shadow.
double sun_share(const Renderer& renderer, const Pictures& pictures, std::size_t pixel) {
  const Light light = to_model(renderer.instant().light);
  const auto linear = [&](const std::vector<std::uint8_t>& rgba) {
    return double{linear_from_srgb(static_cast<float>(rgba[4 * pixel]) / 255)};
  };
  const double ambient = double{ambient_reflected(light, {0, 1, 0}).x};
  const double sun = double{light.sun_irradiance.x} * std::sqrt(0.5) / 3.14159265;
  return (linear(pictures.color) / linear(pictures.albedo) - ambient) / sun;
}

TEST(WideScene, IsWide) {
  const Bounds bounds = make_field(1).bounds(false);
  EXPECT_GE(bounds.high.x - bounds.low.x, 200);
  EXPECT_GT(make_field(1).objects.size(), 150U);
  EXPECT_NE(make_field(2).objects[9].world_from_object, make_field(1).objects[9].world_from_object);
}

TEST(WideScene, ThePostsShadowEndsWhereGeometrySays) {
  Renderer renderer(shared_context(), field());
  for (const glm::vec3& eye : {glm::vec3{1, 4, -0.8F}, glm::vec3{3.1F, 3.3F, -2.2F}}) {
    const splatbus_camera camera = look_at(eye, {1, 0, -0.8F}, 256, 256, 40);
    const Pictures& pictures = renderer.render(camera, kAll);
    int dark = 0, lit = 0;
    for (std::size_t i = 0; i < pictures.object_id.size(); ++i) {
      const float* p = &pictures.world_position[4 * i];
      if (pictures.object_id[i] != 1 || p[2] > -0.15F) continue;  // away from the post's foot
      const float across = std::abs(p[0] - 1) - 0.05F, along = -1.55F - p[2];
      if (std::abs(across) < 0.03F || std::abs(along) < 0.045F) continue;
      const float outside_m = std::max(across, along);
      const double share = sun_share(renderer, pictures, i);
      ASSERT_NEAR(share, outside_m > 0 ? 1 : 0, 0.04) << p[0] << ", " << p[2];
      ++(outside_m > 0 ? lit : dark);
    }
    EXPECT_GT(dark, 200);
    EXPECT_GT(lit, 10000);
  }
}

TEST(WideScene, NoCascadeShadesTheField) {
  Renderer renderer(shared_context(), field());
  for (const float distance_m : {0.0F, 9.0F, 30.0F, 70.0F}) {
    const splatbus_camera camera =
        look_at({distance_m, 2, 0.3F * distance_m}, {2 * distance_m + 6, 0, 0.6F * distance_m}, 128, 128, 60);
    const Pictures& pictures = renderer.render(camera, kAll);
    int dark = 0, seen = 0;
    for (std::size_t i = 0; i < pictures.object_id.size(); ++i) {
      if (pictures.object_id[i] != 1 || pictures.albedo[4 * i + 3] < 255) continue;
      ++seen;
      dark += sun_share(renderer, pictures, i) < 0.9 ? 1 : 0;
    }
    EXPECT_GT(seen, 3000) << distance_m;
    EXPECT_LT(dark, seen / 12) << distance_m << ": shadows are few and thin";
  }
}

TEST(WideScene, CascadesAreDrawnAgainOnlyWhenTheCameraMoves) {
  // What a pixel shows of a shadow far from its border stays as the camera glides by; and nothing is drawn again while
  // the camera stays within an eighth of a cascade's width, which is 24.6 m at the least.
  Renderer renderer(shared_context(), field());
  const auto drawn = [&](const glm::vec3& eye) {
    static_cast<void>(renderer.render(look_at(eye, {1, 0, -0.8F}, 16, 16, 40), SPLATBUS_BUFFER_COLOR));
    return renderer.shadow_maps_drawn();
  };
  EXPECT_EQ(drawn({1, 4, -0.8F}), 3U);
  EXPECT_EQ(drawn({1, 4, -0.8F}), 3U);
  EXPECT_EQ(drawn({1.5F, 4, -0.8F}), 3U);
  EXPECT_EQ(drawn({9, 4, -0.8F}), 4U) << "the finest one";
  EXPECT_EQ(drawn({49, 4, -0.8F}), 6U) << "the two about the camera";
  EXPECT_EQ(drawn({9, 4, -0.8F}), 6U) << "those of the last places are kept";
  EXPECT_EQ(drawn({1, 4, -0.8F}), 6U);
  EXPECT_EQ(drawn({-40, 4, -0.8F}), 8U);
  EXPECT_EQ(drawn({-40, 4, 40}), 10U);
  EXPECT_EQ(drawn({49, 4, -0.8F}), 11U) << "of the finest four are kept, and of the wider ones this is the fourth";
}

TEST(WideScene, PicturesTakenInTurnAtSeveralPlacesAreThoseOfEachAlone) {
  Renderer in_turn(shared_context(), field());
  // More of them than cascades are kept.
  const std::vector<glm::vec3> eyes{{1, 2, -0.8F}, {9, 2, 3}, {49, 2, 8}, {-30, 2, 25}, {20, 2, -60}, {70, 2, 70}};
  for (int round = 0; round < 3; ++round) {
    const auto light = [&](Renderer& renderer) {
      renderer.turn_sun(round == 1 ? 90 : 90 + 40 * round);
      renderer.set_time(0);
    };
    light(in_turn);
    for (const glm::vec3& eye : eyes) {
      const splatbus_camera camera = look_at(eye, eye + glm::vec3(6, -1.5F, 2), 64, 64, 70);
      Renderer alone(shared_context(), field());
      light(alone);
      const std::vector<std::uint8_t> expected = alone.render(camera, SPLATBUS_BUFFER_COLOR).color;
      EXPECT_EQ(in_turn.render(camera, SPLATBUS_BUFFER_COLOR).color, expected) << eye.x << " in round " << round;
    }
  }
}

}  // namespace
}  // namespace splatbus::sim
