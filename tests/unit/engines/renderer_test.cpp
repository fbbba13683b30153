#include "sim/renderer.h"

#include <gmock/gmock.h>

#include <cmath>
#include <glm/gtc/matrix_transform.hpp>
#include <set>

#include "render_scenes.h"
#include "sim/toys.h"

namespace splatbus::sim {
namespace {

constexpr std::uint32_t kAll = SPLATBUS_BUFFER_COLOR | SPLATBUS_BUFFER_WORLD_POSITION | SPLATBUS_BUFFER_NORMAL |
                               SPLATBUS_BUFFER_ALBEDO | SPLATBUS_BUFFER_DEPTH;

Renderer& toys() {
  static Renderer renderer(shared_context(), make_toys(1, true));
  return renderer;
}

splatbus_camera ring_camera(float angle, std::uint32_t size = 96) {
  return look_at({3.4F * std::cos(angle), 1.6F, 3.4F * std::sin(angle)}, {0, 0.25F, 0}, size, size, 60);
}

TEST(Renderer, SameCameraSameBytes) {
  toys().set_time(0.7);
  const Pictures first = toys().render(ring_camera(1), kAll);
  toys().set_time(2.1);
  static_cast<void>(toys().render(ring_camera(2, 64), kAll));
  toys().set_time(0.7);
  const Pictures& again = toys().render(ring_camera(1), kAll);
  EXPECT_EQ(first.color, again.color);
  EXPECT_EQ(first.albedo, again.albedo);
  EXPECT_EQ(first.world_position, again.world_position);
  EXPECT_EQ(first.normal, again.normal);
  EXPECT_EQ(first.depth, again.depth);
}

TEST(Renderer, OnlyWhatIsAskedForIsThere) {
  const Pictures& pictures = toys().render(ring_camera(1, 32), SPLATBUS_BUFFER_ALBEDO | SPLATBUS_BUFFER_NORMAL);
  EXPECT_TRUE(pictures.color.empty());
  EXPECT_EQ(pictures.albedo.size(), 4U * 32 * 32);
  EXPECT_EQ(pictures.normal.size(), 4U * 32 * 32);
  EXPECT_TRUE(pictures.world_position.empty());
  EXPECT_TRUE(pictures.depth.empty());
  EXPECT_TRUE(pictures.light_depth.empty());
}

TEST(Renderer, PositionsLieOnTheRaysOfTheirPixelCentres) {
  for (const float angle : {0.3F, 2.5F}) {
    splatbus_camera camera = ring_camera(angle);
    camera.cx += 3.25F;  // off the middle
    camera.fy *= 1.2F;
    const Pictures& pictures = toys().render(camera, kAll);
    const glm::mat4 view = camera_from_world(camera);
    std::set<float> ids;
    for (std::uint32_t y = 0; y < camera.height; ++y) {
      for (std::uint32_t x = 0; x < camera.width; ++x) {
        const std::size_t i = std::size_t{y} * camera.width + x;
        const float* p = &pictures.world_position[4 * i];
        if (p[3] == 0) {
          EXPECT_EQ(pictures.depth[i], 0);
          continue;
        }
        ids.insert(p[3]);
        const glm::vec3 c = view * glm::vec4(p[0], p[1], p[2], 1);
        ASSERT_NEAR(camera.fx * c.x / c.z + camera.cx, static_cast<float>(x) + 0.5F, 0.02F);
        ASSERT_NEAR(camera.fy * c.y / c.z + camera.cy, static_cast<float>(y) + 0.5F, 0.02F);
        ASSERT_NEAR(c.z, pictures.depth[i], 1e-3F);
      }
    }
    EXPECT_GE(ids.size(), 12U);
    EXPECT_EQ(*ids.begin(), 1.0F);
  }
}

TEST(Renderer, NormalsAreUnitAndFaceTheCamera) {
  const splatbus_camera camera = ring_camera(4);
  const Pictures& pictures = toys().render(camera, kAll);
  const float* t = camera.world_from_camera.translation;
  int surfaces = 0;
  int away = 0;
  for (std::size_t i = 0; i < pictures.depth.size(); ++i) {
    if (pictures.depth[i] == 0) continue;
    ++surfaces;
    const glm::vec3 n{pictures.normal[4 * i], pictures.normal[4 * i + 1], pictures.normal[4 * i + 2]};
    ASSERT_NEAR(glm::length(n), 1, 1e-4F);
    const glm::vec3 p{pictures.world_position[4 * i], pictures.world_position[4 * i + 1],
                      pictures.world_position[4 * i + 2]};
    const float cosine = glm::dot(n, glm::normalize(glm::vec3(t[0], t[1], t[2]) - p));
    ASSERT_GT(cosine, -0.3F);  // interpolated normals bend away a little at the rim of a round toy
    if (cosine < 0) ++away;
  }
  EXPECT_GT(surfaces, 1000);
  EXPECT_LT(away, surfaces / 100);
}

TEST(Renderer, MovingObjectsAreListedWhereTheyAre) {
  toys().set_time(0.35);
  const Instant instant = toys().instant();
  ASSERT_EQ(instant.moving.size(), 2U);
  const splatbus_object& ball = instant.moving[0];
  const float* t = ball.world_from_object.translation;
  const Pictures& pictures = toys().render(ring_camera(1.2F), kAll);
  int seen = 0;
  for (std::size_t i = 0; i < pictures.depth.size(); ++i) {
    const float* p = &pictures.world_position[4 * i];
    if (p[3] != static_cast<float>(ball.id)) continue;
    ++seen;
    ASSERT_NEAR(glm::distance(glm::vec3(p[0], p[1], p[2]), glm::vec3(t[0], t[1], t[2])), 0.16F, 0.004F);
  }
  EXPECT_GT(seen, 20);
  toys().set_time(0);
}

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
      if (p[3] != 1.0F || p[1] < -0.001F || p[0] < -1.9F || p[0] > -0.1F) continue;  // away from rims
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

TEST(Renderer, AlphaIsCoverage) {
  const glm::vec3 albedo{0.5F, 0.25F, 0.1F};
  Scene scene;
  add_plain(scene, box({1, 1, 1}), albedo, glm::rotate(glm::mat4(1), glm::radians(31.0F), glm::vec3(0, 1, 0)));
  Renderer renderer(shared_context(), std::move(scene));
  const splatbus_camera camera = look_at({0, 6, 0}, {0, 0, 0}, 64, 64, 20);
  const Pictures& pictures = renderer.render(camera, kAll);
  double covered = 0;
  std::set<int> partial;
  const Light light = to_model(renderer.instant().light);
  for (std::size_t i = 0; i < pictures.depth.size(); ++i) {
    const int alpha = pictures.color[4 * i + 3];
    covered += alpha / 255.0;
    EXPECT_EQ(alpha, pictures.albedo[4 * i + 3]);
    if (alpha > 0 && alpha < 255) partial.insert(alpha);
    for (std::size_t c = 0; c < 3; ++c) {
      // Albedo is over black, colour over the background.
      const float over_black = linear_from_srgb(static_cast<float>(pictures.albedo[4 * i + c]) / 255);
      ASSERT_NEAR(over_black, albedo[static_cast<int>(c)] * static_cast<float>(alpha) / 255, 0.006F);
      if (alpha == 0) {
        ASSERT_NEAR(pictures.color[4 * i + c], 255 * srgb_from_linear(light.background[static_cast<int>(c)]), 0.75F);
      }
    }
  }
  const double side_px = camera.fx / 5.5;  // the top lies 5.5 m below the camera
  EXPECT_NEAR(covered / (side_px * side_px), 1, 0.003);
  EXPECT_GE(partial.size(), 7U);  // 2 x 2 supersamples alone would give 3
}

TEST(Renderer, TheLightCameraSeesTheWholeScene) {
  Renderer& renderer = toys();
  renderer.set_time(0);
  const splatbus_camera camera = renderer.light_camera(4, 128, 96);
  EXPECT_EQ(camera.id, 4U);
  EXPECT_EQ(Renderer::problem(camera), "");
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
    if (p[3] == 0) continue;
    const glm::vec3 c = view * glm::vec4(p[0], p[1], p[2], 1);
    const auto x = static_cast<int>(camera.fx * c.x + camera.cx);
    const auto y = static_cast<int>(camera.fy * c.y + camera.cy);
    ASSERT_TRUE(x >= 0 && x < 128 && y >= 0 && y < 96);
    if (std::abs(depth[static_cast<std::size_t>(y * 128 + x)] - c.z) < 0.12F) ++agree;
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

TEST(Renderer, CamerasOutOfBoundsAreRefusedByName) {
  const auto words = [](const std::function<void(splatbus_camera&)>& spoil) {
    splatbus_camera camera = ring_camera(0);
    camera.id = 31;
    spoil(camera);
    try {
      static_cast<void>(toys().render(camera, SPLATBUS_BUFFER_COLOR));
    } catch (const std::runtime_error& error) {
      return std::string(error.what());
    }
    return std::string();
  };
  using testing::HasSubstr;
  EXPECT_THAT(words([](auto& c) { c.width = 100000; }),
              testing::AllOf(HasSubstr("camera 31"), HasSubstr("100000 x 96")));
  EXPECT_THAT(words([](auto& c) { c.width = c.height = 4000; }), HasSubstr("out of bounds"));
  EXPECT_THAT(words([](auto& c) { c.fx = 0; }), HasSubstr("fx"));
  EXPECT_THAT(words([](auto& c) { c.near_m = 0; }), HasSubstr("near_m"));
  EXPECT_THAT(words([](auto& c) { c.world_from_camera.translation[2] = NAN; }), HasSubstr("pose"));
  EXPECT_THAT(words([](auto& c) { c.world_from_camera.rotation_wxyz[2] = 3; }), HasSubstr("unit quaternion"));
}

}  // namespace
}  // namespace splatbus::sim
