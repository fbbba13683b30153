#include "sim/renderer.h"

#include <gmock/gmock.h>

#include <array>
#include <cmath>
#include <glm/gtc/matrix_transform.hpp>
#include <set>

#include "sim/camera_check.h"
#include "toy_renderer.h"

namespace splatbus::sim {
namespace {

TEST(Renderer, SameCameraSameBytes) {
  toys().set_time(0.7);
  const Pictures first = toys().render(ring_camera(1), kAll);
  toys().set_time(2.1);
  static_cast<void>(toys().render(ring_camera(2, 64), kAll));
  toys().set_time(0.7);
  const Pictures& again = toys().render(ring_camera(1), kAll);
  expect_same(first, again);
}

TEST(Renderer, OnlyWhatIsAskedForIsThere) {
  const Pictures& pictures = toys().render(ring_camera(1, 32), SPLATBUS_BUFFER_ALBEDO | SPLATBUS_BUFFER_NORMAL);
  EXPECT_TRUE(pictures.color.empty());
  EXPECT_EQ(pictures.albedo.size(), 4U * 32 * 32);
  EXPECT_EQ(pictures.normal.size(), 4U * 32 * 32);
  EXPECT_TRUE(pictures.world_position.empty());
  EXPECT_TRUE(pictures.depth.empty());
  EXPECT_TRUE(pictures.object_id.empty());
  EXPECT_TRUE(pictures.light_depth.empty());
}

TEST(Renderer, PositionsLieOnTheRaysOfTheirPixelCentres) {
  for (const float angle : {0.3F, 2.5F}) {
    splatbus_camera camera = ring_camera(angle);
    camera.cx += 3.25F;  // off the middle
    camera.fy *= 1.2F;
    const Pictures& pictures = toys().render(camera, kAll);
    const glm::mat4 view = camera_from_world(camera);
    std::set<std::uint32_t> ids;
    for (std::uint32_t y = 0; y < camera.height; ++y) {
      for (std::uint32_t x = 0; x < camera.width; ++x) {
        const std::size_t i = std::size_t{y} * camera.width + x;
        const float* p = &pictures.world_position[4 * i];
        if (pictures.object_id[i] == 0) {
          EXPECT_EQ(pictures.depth[i], 0);
          continue;
        }
        ids.insert(pictures.object_id[i]);
        const glm::vec3 c = view * glm::vec4(p[0], p[1], p[2], 1);
        ASSERT_NEAR(camera.fx * c.x / c.z + camera.cx, static_cast<float>(x) + 0.5F, 0.02F);
        ASSERT_NEAR(camera.fy * c.y / c.z + camera.cy, static_cast<float>(y) + 0.5F, 0.02F);
        ASSERT_NEAR(c.z, pictures.depth[i], 1e-3F);
      }
    }
    EXPECT_GE(ids.size(), 12U);
    EXPECT_EQ(*ids.begin(), 1U);
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
  ASSERT_EQ(instant.objects.size(), 15U) << "all that live but the crate, which comes later, and the player's camera";
  const splatbus_object& ball = instant.objects[0];
  const float* t = ball.world_from_object.translation;
  const Pictures& pictures = toys().render(ring_camera(1.2F), kAll);
  int seen = 0;
  for (std::size_t i = 0; i < pictures.depth.size(); ++i) {
    const float* p = &pictures.world_position[4 * i];
    if (pictures.object_id[i] != ball.id) continue;
    ++seen;
    ASSERT_NEAR(glm::distance(glm::vec3(p[0], p[1], p[2]), glm::vec3(t[0], t[1], t[2])), 0.16F, 0.004F);
  }
  EXPECT_GT(seen, 20);
  toys().set_time(0);
}

TEST(Renderer, ObjectIdsKeepAllTheirBits) {
  Scene scene;
  const std::array<std::uint32_t, 4> ids{(1U << 24U) + 1, 0x7F800001, 0x80000000, 0xFFFFFFFF};
  for (std::size_t k = 0; k < ids.size(); ++k) {
    add_plain(scene, box({0.4F, 0.4F, 0.4F}), {0.5F, 0.5F, 0.5F},
              glm::translate(glm::mat4(1), {static_cast<float>(k) - 1.5F, 0, 0}));
    scene.objects.back().id = ids.at(k);
  }
  Renderer renderer(shared_context(), std::move(scene));
  const Pictures& pictures =
      renderer.render(look_at({0, 6, 0}, {0, 0, 0}, 64, 64, 60), SPLATBUS_BUFFER_OBJECT_ID | SPLATBUS_BUFFER_DEPTH);
  std::set<std::uint32_t> seen;
  for (std::size_t i = 0; i < pictures.object_id.size(); ++i) {
    EXPECT_EQ(pictures.object_id[i] == 0, pictures.depth[i] == 0);
    if (pictures.object_id[i] != 0) seen.insert(pictures.object_id[i]);
  }
  EXPECT_EQ(seen, std::set<std::uint32_t>(ids.begin(), ids.end()));
}

TEST(Renderer, EachOfManyTexturesIsOnItsOwnObject) {
  // Of two sizes, of one of them more than one array keeps; each is on two objects.
  constexpr int kAcross = 26;
  Scene scene;
  std::vector<glm::vec3> bytes;
  for (int k = 0; k < kAcross * kAcross; ++k) {
    const std::uint32_t side = k % 7 == 0 ? 4 : 1;
    bytes.emplace_back(40 + k % 23 * 9, 40 + k / 23 * 7, 60 + k % 5 * 40);
    Image image{.width = side, .height = side, .rgba = {}};
    for (std::uint32_t i = 0; i < side * side; ++i) {
      for (int c = 0; c < 3; ++c) image.rgba.push_back(static_cast<std::uint8_t>(bytes.back()[c]));
      image.rgba.push_back(255);
    }
    const glm::mat4 place = glm::translate(glm::mat4(1), {k % kAcross, 0, k / kAcross});
    if (k % 2 == 1) {
      scene.add("as the one before", box({0.8F, 0.2F, 0.8F}), static_cast<int>(scene.materials.size()) - 1, place);
      bytes.back() = bytes[bytes.size() - 2];
    } else {
      scene.add("its own", box({0.8F, 0.2F, 0.8F}), std::move(image), place);
    }
  }
  constexpr std::uint32_t kSize = 416;
  Renderer renderer(shared_context(), std::move(scene), {.supersample = 1, .samples = 1});
  const float middle = 0.5F * (kAcross - 1);
  const splatbus_camera camera = look_at({middle, 40, middle - 1e-3F}, {middle, 0, middle}, kSize, kSize, 40);
  const Pictures& pictures = renderer.render(camera, SPLATBUS_BUFFER_ALBEDO | SPLATBUS_BUFFER_OBJECT_ID);
  std::set<std::uint32_t> seen;
  for (std::size_t i = 0; i < pictures.object_id.size(); ++i) {
    const std::uint32_t id = pictures.object_id[i];
    if (id == 0) continue;
    seen.insert(id);
    for (std::size_t c = 0; c < 3; ++c) {
      ASSERT_NEAR(pictures.albedo[4 * i + c], bytes.at(id - 1)[static_cast<int>(c)], 1.5F) << "object " << id;
    }
  }
  EXPECT_EQ(seen.size(), bytes.size());
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
  EXPECT_THAT(words([](auto& c) { c.width = c.height = 4097; }), HasSubstr("out of bounds"));
  EXPECT_THAT(words([](auto& c) { c.fx = 0; }), HasSubstr("fx"));
  EXPECT_THAT(words([](auto& c) { c.near_m = 0; }), HasSubstr("near_m"));
  EXPECT_THAT(words([](auto& c) { c.world_from_camera.translation[2] = NAN; }), HasSubstr("pose"));
  EXPECT_THAT(words([](auto& c) { c.world_from_camera.rotation_wxyz[2] = 3; }), HasSubstr("unit quaternion"));
}

}  // namespace
}  // namespace splatbus::sim
