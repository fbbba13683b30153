// Shading, shadows and the light's camera.
#include <gmock/gmock.h>

#include <cmath>
#include <glm/gtc/matrix_transform.hpp>
#include <set>

#include "sim/camera_check.h"
#include "toy_renderer.h"

namespace splatbus::sim {
namespace {

TEST(Renderer, ALitPatchIsTheShadingModel) {
  const glm::vec3 albedo{0.62F, 0.4F, 0.2F};
  for (int turn = 0; turn < 6; ++turn) {
    const glm::vec3 normal =
        glm::normalize(glm::vec3(std::cos(1.1F * static_cast<float>(turn)), 0.4F + 0.1F * static_cast<float>(turn),
                                 std::sin(1.7F * static_cast<float>(turn))));
    // A slab whose top faces along the normal; it casts shadows, so that it could shade itself.
    const glm::vec3 axis = glm::normalize(glm::cross(glm::vec3(0, 1, 0), normal));
    Scene scene;
    add_plain(scene, box({2, 0.1F, 2}), albedo, glm::rotate(glm::mat4(1), std::acos(normal.y), axis));
    scene.lighting.sun_azimuth_deg = 60.0 * turn;
    scene.lighting.sun_zenith_deg = 35;
    for (int k = 0; k < 27; ++k)
      scene.lighting.ambient.ambient_sh[k] = k % 9 == 0 ? 0.9F : 0.12F * std::sin(2.3F * static_cast<float>(k));
    Renderer renderer(shared_context(), std::move(scene));
    const splatbus_camera camera = look_at(2.0F * normal, {0, 0, 0}, 32, 32, 30);
    const Pictures& pictures = renderer.render(camera, SPLATBUS_BUFFER_COLOR);
    const glm::vec3 expected = expected_bytes(to_model(renderer.instant().light), albedo, normal, 1);
    for (std::uint32_t y = 0; y < 32; ++y) {
      for (std::uint32_t x = 0; x < 32; ++x) {
        const glm::vec3 found = pixel_bytes(pictures.color, 32, x, y);
        for (int c = 0; c < 3; ++c)
          ASSERT_NEAR(found[c], expected[c], 0.75F) << "turn " << turn << " pixel " << x << ", " << y;
      }
    }
  }
}

TEST(Renderer, ShadowsFallWhereTheSunIsHidden) {
  const glm::vec3 albedo{0.5F};
  Scene scene;
  add_plain(scene, box({4, 0.1F, 4}), albedo, glm::translate(glm::mat4(1), {0, -0.05F, 0}));
  add_plain(scene, box({0.5F, 0.5F, 0.5F}), albedo, glm::translate(glm::mat4(1), {0, 1.0F, 0}));
  scene.lighting.sun_azimuth_deg = 0;
  scene.lighting.sun_zenith_deg = 45;  // so the shadow's middle is 1 m towards -x
  Renderer renderer(shared_context(), std::move(scene));
  const Light light = to_model(renderer.instant().light);
  const splatbus_camera camera = look_at({-1.0F, 3, 0}, {-1.0F, 0, 0}, 129, 129, 40);
  const Pictures& pictures = renderer.render(camera, kAll);
  const glm::vec3 shadowed = expected_bytes(light, albedo, {0, 1, 0}, 0);
  const glm::vec3 lit = expected_bytes(light, albedo, {0, 1, 0}, 1);
  ASSERT_GT(lit.x - shadowed.x, 30);
  int counts[3] = {0, 0, 0};
  for (std::uint32_t y = 0; y < 129; ++y) {
    for (std::uint32_t x = 0; x < 129; ++x) {
      const float* p = &pictures.world_position[4 * (std::size_t{y} * 129 + x)];
      if (pictures.object_id[std::size_t{y} * 129 + x] != 1 || p[1] < -0.001F || p[0] < -1.9F || p[0] > -0.1F)
        continue;  // away from rims
      // The box's shadow: its own width across, and from its upper to its lower edge along the sun.
      const float along = std::abs(p[0] + 1.0F);
      const float across = std::abs(p[2]);
      const float red = pixel_bytes(pictures.color, 129, x, y).x;
      if (along < 0.45F && across < 0.2F) {
        ASSERT_NEAR(red, shadowed.x, 0.75F);
        ++counts[0];
      } else if (along > 0.55F || across > 0.3F) {
        ASSERT_NEAR(red, lit.x, 0.75F) << p[0] << ", " << p[2];
        ++counts[1];
      } else {
        ASSERT_GE(red, shadowed.x - 0.75F);
        ASSERT_LE(red, lit.x + 0.75F);
        if (red > shadowed.x + 2 && red < lit.x - 2) ++counts[2];
      }
    }
  }
  EXPECT_GT(counts[0], 100);
  EXPECT_GT(counts[1], 1000);
  EXPECT_GT(counts[2], 20);  // soft edges
}

TEST(Renderer, TheLightCameraSeesTheWholeScene) {
  Renderer& renderer = toys();
  renderer.set_time(0);
  const splatbus_camera camera = renderer.light_camera(4, 128, 96);
  EXPECT_EQ(camera.id, 4U);
  EXPECT_EQ(camera_problem(camera), "");
  const std::vector<float> depth = renderer.render(camera, SPLATBUS_BUFFER_LIGHT_DEPTH).light_depth;
  ASSERT_EQ(depth.size(), 128U * 96);
  const glm::mat4 clip_from_world = clip_from_camera(camera) * camera_from_world(camera);
  const Bounds bounds = renderer.scene().bounds(false);
  for (int corner = 0; corner < 8; ++corner) {
    const glm::vec4 p = clip_from_world * glm::vec4(bounds.corner(corner), 1);
    for (int axis = 0; axis < 3; ++axis) EXPECT_LT(std::abs(p[axis]), 1.0F);
  }
  EXPECT_THAT(depth, testing::Each(testing::AllOf(testing::Gt(camera.near_m), testing::Le(camera.far_m))));
  EXPECT_EQ(depth.front(), camera.far_m);

  // What a camera sees lit is what the light sees: its depth agrees, or something nearer hides it.
  const splatbus_camera eye = ring_camera(0.7F);
  const Pictures& pictures = renderer.render(eye, kAll);
  const glm::mat4 view = camera_from_world(camera);
  int agree = 0;
  for (std::size_t i = 0; i < pictures.depth.size(); ++i) {
    const float* p = &pictures.world_position[4 * i];
    if (pictures.object_id[i] == 0) continue;
    const glm::vec3 c = view * glm::vec4(p[0], p[1], p[2], 1);
    const auto x = static_cast<int>(camera.fx * c.x + camera.cx);
    const auto y = static_cast<int>(camera.fy * c.y + camera.cy);
    ASSERT_TRUE(x >= 0 && x < 128 && y >= 0 && y < 96);
    if (std::abs(depth[static_cast<std::size_t>(y) * 128 + x] - c.z) < 0.12F) ++agree;
  }
  EXPECT_GT(agree, 2000);
}

TEST(Renderer, TheShadowMapIsDrawnOnlyWhenTheSceneMoves) {
  Scene scene;
  add_plain(scene, box({1, 1, 1}), glm::vec3(0.5F));
  scene.lighting.sun_rate_deg_s = 0;
  Renderer still(shared_context(), scene);
  const splatbus_camera camera = look_at({0, 2, 3}, {0, 0, 0}, 16, 16, 50);
  for (int frame = 0; frame < 3; ++frame) {
    still.set_time(frame);
    static_cast<void>(still.render(camera, SPLATBUS_BUFFER_COLOR));
  }
  EXPECT_EQ(still.shadow_maps_drawn(), 1U);
  EXPECT_EQ(still.scene_version(), 1U);

  scene.lighting.sun_rate_deg_s = 15;
  Renderer turning(shared_context(), scene);
  for (int frame = 0; frame < 3; ++frame) {
    turning.set_time(frame);
    static_cast<void>(turning.render(camera, SPLATBUS_BUFFER_DEPTH));
  }
  EXPECT_EQ(turning.shadow_maps_drawn(), 0U);
  EXPECT_EQ(turning.scene_version(), 3U);
}

TEST(Renderer, TheSunTurnsAboutTheVertical) {
  Lighting lighting;
  lighting.sun_azimuth_deg = 10;
  lighting.sun_rate_deg_s = 15;
  const splatbus_light later = lighting.at(4);
  EXPECT_NEAR(std::atan2(later.sun_direction[2], later.sun_direction[0]), glm::radians(70.0), 1e-5);
  EXPECT_NEAR(later.sun_direction[1], std::cos(glm::radians(45.0)), 1e-6);
}

TEST(Renderer, TheSunGoesWhereItIsTurned) {
  Scene scene;
  add_plain(scene, box({1, 1, 1}), glm::vec3(0.5F));
  scene.lighting.sun_rate_deg_s = 15;
  Renderer renderer(shared_context(), scene);
  const auto azimuth_deg = [&] {
    const float* sun = renderer.instant().light.sun_direction;
    return glm::degrees(std::atan2(sun[2], sun[0]));
  };
  renderer.set_time(4);
  const std::uint64_t version = renderer.scene_version();
  renderer.turn_sun(-20);
  renderer.set_time(4);
  EXPECT_NEAR(azimuth_deg(), -20, 1e-4);
  EXPECT_GT(renderer.scene_version(), version);
  renderer.set_time(6);
  EXPECT_NEAR(azimuth_deg(), 10, 1e-4) << "from there it goes on";
}

}  // namespace
}  // namespace splatbus::sim
