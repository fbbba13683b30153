// Depth maps of lights: their cameras, what they show, and when they would show anything else.
#include "sim/light_maps.h"

#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>
#include <glm/gtc/matrix_transform.hpp>

#include "sim/camera_check.h"
#include "source_scenes.h"
#include "toy_renderer.h"

namespace splatbus::sim {
namespace {

splatbus_camera_request map_request(std::uint32_t light_id, std::uint32_t light_map, std::uint32_t size = 64) {
  splatbus_camera_request request{};
  request.camera.id = 40 + light_map;
  request.camera.role = SPLATBUS_ROLE_LIGHT;
  request.camera.width = request.camera.height = size;
  request.light_id = light_id;
  request.light_map = light_map;
  return request;
}

/// A light in a room of 2 x 1.6 x 2.4 m about it, whose walls are boxes of 0.1 m.
constexpr glm::vec3 kHalfRoom{1, 0.8F, 1.2F};
Scene room_about(const splatbus_light_source& source) {
  const glm::vec3 middle{source.position[0], source.position[1], source.position[2]};
  Scene scene;
  for (int axis = 0; axis < 3; ++axis) {
    for (const float side : {-1.0F, 1.0F}) {
      glm::vec3 size = 2.0F * kHalfRoom + 0.4F, at = middle;
      size[axis] = 0.1F;
      at[axis] += side * (kHalfRoom[axis] + 0.05F);
      add_plain(scene, box(size), glm::vec3(0.5F), glm::translate(glm::mat4(1), at));
    }
  }
  make_dark(scene.lighting);
  add_source(scene.lighting, source);
  return scene;
}

/// Along a camera's z, where a ray from the middle of the room meets its walls.
float depth_in_room(const glm::vec3& direction, const glm::vec3& forward) {
  float nearest = 1e9F;
  for (int axis = 0; axis < 3; ++axis)
    nearest = std::min(nearest, kHalfRoom[axis] / std::max(std::abs(direction[axis]), 1e-9F));
  return nearest * glm::dot(direction, forward);
}

TEST(LightMaps, SixFacesOfAPointLightShowEverythingAroundIt) {
  const splatbus_light_source source = point_source();
  Renderer renderer(shared_context(), room_about(source));
  std::vector<LightCamera> faces;
  for (std::uint32_t face = 0; face < 6; ++face) {
    const std::optional<LightCamera> view = renderer.light_camera(map_request(1, face));
    ASSERT_TRUE(view.has_value());
    EXPECT_EQ(view->camera.id, 40 + face);
    EXPECT_EQ(view->projection, Projection::Pinhole);
    EXPECT_EQ(camera_problem(view->camera), "");
    EXPECT_EQ(view->camera.far_m, source.range_m);
    faces.push_back(*view);
    const std::vector<float> depth = renderer.render(*view, SPLATBUS_BUFFER_LIGHT_DEPTH).light_depth;
    const glm::mat3 world_from_camera = glm::transpose(glm::mat3(camera_from_world(view->camera)));
    for (std::uint32_t i = 0; i < 64 * 64; ++i) {
      const glm::vec3 ray{(static_cast<float>(i % 64) + 0.5F - view->camera.cx) / view->camera.fx,
                          (static_cast<float>(i / 64) + 0.5F - view->camera.cy) / view->camera.fy, 1};
      ASSERT_NEAR(depth[i], depth_in_room(world_from_camera * ray, world_from_camera[2]), 1e-4F) << face << ' ' << i;
    }
  }
  // Each direction is in one face, two texels from its border, or in several.
  for (int i = 0; i < 5000; ++i) {
    const float y = 1 - 2 * (static_cast<float>(i) + 0.5F) / 5000;
    const float turn = 2.3999632F * static_cast<float>(i);
    const glm::vec3 direction{std::sqrt(1 - y * y) * std::cos(turn), y, std::sqrt(1 - y * y) * std::sin(turn)};
    const bool covered = std::ranges::any_of(faces, [&](const LightCamera& face) {
      const splatbus_camera& camera = face.camera;
      const glm::vec3 c = glm::mat3(camera_from_world(camera)) * direction;
      const glm::vec2 px{camera.fx * c.x / c.z + camera.cx, camera.fy * c.y / c.z + camera.cy};
      return c.z > 0 && std::min(px.x, px.y) >= 1.99F && std::max(px.x, px.y) <= 62.01F;
    });
    ASSERT_TRUE(covered) << direction.x << ", " << direction.y << ", " << direction.z;
  }
}

TEST(LightMaps, ASpotLightsMapIsItsCone) {
  const splatbus_light_source source = spot_source();
  const splatbus_camera camera = spot_camera(source, 100, 60);
  const glm::mat3 view(camera_from_world(camera));
  const glm::vec3 axis{source.direction[0], source.direction[1], source.direction[2]};
  EXPECT_LT(glm::distance(view * axis, glm::vec3(0, 0, 1)), 1e-5F);
  const float edge = std::tan(std::acos(source.cos_outer));
  EXPECT_NEAR(camera.fx * edge + camera.cx, 98, 1e-3F);
  EXPECT_NEAR(camera.cy - camera.fy * edge, 2, 1e-3F);
}

TEST(LightMaps, ThereIsNoneOfWhatIsNotThere) {
  splatbus_light_source through = spot_source();
  through.casts_shadow = 0;
  Scene scene = room_about(point_source());
  add_source(scene.lighting, through);
  add_source(scene.lighting, spot_source());
  scene.lighting.sources[2].at = [](double time_s) { return time_s < 1 ? std::nullopt : std::optional(spot_source()); };
  Renderer renderer(shared_context(), std::move(scene));
  EXPECT_FALSE(renderer.light_camera(map_request(1, 6)).has_value());
  EXPECT_FALSE(renderer.light_camera(map_request(2, 0)).has_value()) << "it casts no shadow";
  EXPECT_FALSE(renderer.light_camera(map_request(4, 0)).has_value());
  EXPECT_FALSE(renderer.depth_version(map_request(3, 0)).has_value());
  renderer.set_time(1);
  EXPECT_TRUE(renderer.depth_version(map_request(3, 0)).has_value());
  EXPECT_FALSE(renderer.light_camera(map_request(3, 1)).has_value());
}

TEST(LightMaps, ACascadeMovesByWholeTexels) {
  Bounds scene;
  scene.add({-100, -1, -80});
  scene.add({100, 9, 90});
  const glm::vec3 to_light = glm::normalize(glm::vec3(0.3F, 0.8F, -0.5F));
  const splatbus_camera first = cascade_camera({10, 2, 5}, 16, to_light, scene, 512, 512);
  EXPECT_FLOAT_EQ(first.fx, 512 / 16.0F);
  const auto pixel = [](const splatbus_camera& camera, const glm::vec3& p) {
    const glm::vec3 c = camera_from_world(camera) * glm::vec4(p, 1);
    return glm::vec3(camera.fx * c.x + camera.cx, camera.fy * c.y + camera.cy, c.z);
  };
  for (int step = 0; step < 50; ++step) {
    const glm::vec3 centre = glm::vec3(10, 2, 5) + 0.0137F * static_cast<float>(step) * glm::vec3(1, 0.2F, -0.7F);
    const splatbus_camera camera = cascade_camera(centre, 16, to_light, scene, 512, 512);
    const glm::vec3 middle = pixel(camera, centre);
    ASSERT_NEAR(middle.x, 256, 0.51F) << "the square is about the centre";
    ASSERT_NEAR(middle.y, 256, 0.51F);
    const glm::vec3 moved = pixel(camera, {9, 1, 4}) - pixel(first, {9, 1, 4});
    ASSERT_NEAR(moved.x, std::round(moved.x), 0.01F);
    ASSERT_NEAR(moved.y, std::round(moved.y), 0.01F);
    for (int corner = 0; corner < 8; ++corner) {
      const float z = pixel(camera, scene.corner(corner)).z;
      ASSERT_GT(z, camera.near_m);
      ASSERT_LT(z, camera.far_m);
    }
  }
}

TEST(LightMaps, ACascadeShowsWhatTheSunSees) {
  splatbus_camera_request request = map_request(0, 2, 128);
  request.extent_m = 2;
  request.camera.world_from_camera.translation[0] = 0.4F;
  toys().set_time(0);
  const LightCamera cascade = toys().light_camera(request).value();
  EXPECT_EQ(cascade.projection, Projection::Orthographic);
  EXPECT_FLOAT_EQ(cascade.camera.fx, 64);
  const std::vector<float> depth = toys().render(cascade, SPLATBUS_BUFFER_LIGHT_DEPTH).light_depth;
  const Pictures& pictures = toys().render(ring_camera(0.7F), kAll);
  const glm::mat4 view = camera_from_world(cascade.camera);
  int agree = 0;
  for (std::size_t i = 0; i < pictures.depth.size(); ++i) {
    const float* p = &pictures.world_position[4 * i];
    const glm::vec3 c = view * glm::vec4(p[0], p[1], p[2], 1);
    const auto x = static_cast<int>(std::floor(64 * c.x + 64));
    const auto y = static_cast<int>(std::floor(64 * c.y + 64));
    if (pictures.object_id[i] == 0 || x < 0 || x >= 128 || y < 0 || y >= 128) continue;
    agree += std::abs(depth[static_cast<std::size_t>(y) * 128 + static_cast<std::size_t>(x)] - c.z) < 0.03F ? 1 : 0;
  }
  EXPECT_GT(agree, 1000);
}

/// A block that moves from second 1 to 2 and a lamp's glass that always does, under the sun, a point light within 1 m
/// of the block's way, one farther off, and a spot light that looks away from it.
class Versions : public testing::Test {
 protected:
  Versions() : renderer_(shared_context(), scene()) {}

  static Scene scene() {
    Scene scene;
    add_plain(scene, box({4, 0.1F, 4}), glm::vec3(0.5F));
    add_plain(scene, box({0.2F, 0.2F, 0.2F}), glm::vec3(0.5F));
    scene.objects.back().motion_origins.add({0, 0.5F, 0});
    scene.objects.back().motion_origins.add({1, 0.5F, 0});
    scene.objects.back().motion = [](double time_s) {
      return Pose{.translation = {std::clamp(static_cast<float>(time_s) - 1, 0.0F, 1.0F), 0.5F, 0}};
    };
    add_plain(scene, sphere(0.1F, 12), glm::vec3(0.5F));
    scene.objects.back().emissive = true;
    scene.objects.back().casts_shadow = false;
    scene.objects.back().motion = [](double time_s) {
      return Pose{.translation = {0, 0.7F + 0.01F * static_cast<float>(time_s), 0.5F}};
    };
    splatbus_light_source near = point_source(), far = point_source(), spot = spot_source();
    near.range_m = far.range_m = 1;
    far.position[0] = -1.5F;
    near.position[1] = far.position[1] = 0.6F;
    spot.direction[0] = 1;
    spot.direction[1] = spot.direction[2] = 0;
    spot.position[0] = 1.3F;
    add_source(scene.lighting, near);
    add_source(scene.lighting, far);
    add_source(scene.lighting, spot);
    return scene;
  }

  /// Of the sun, and of lights 1 to 3.
  std::array<std::uint64_t, 4> at(double time_s) {
    renderer_.set_time(time_s);
    std::array<std::uint64_t, 4> result{};
    for (std::uint32_t id = 0; id < 4; ++id) result.at(id) = renderer_.depth_version(map_request(id, 0)).value_or(0);
    return result;
  }

  Renderer renderer_;
};

TEST_F(Versions, FollowWhatMovesWithinALightsReach) {
  const auto first = at(0);
  EXPECT_THAT(first, testing::Each(testing::Gt(0U)));
  EXPECT_EQ(at(0.5), first) << "only the lamp's glass has moved";
  EXPECT_EQ(renderer_.instant().sources[0].depth_version, first[1]);
  EXPECT_EQ(renderer_.instant().light.sun_depth_version, first[0]);
  const auto moved = at(1.5);
  EXPECT_GT(moved[0], first[0]);
  EXPECT_GT(moved[1], first[1]);
  EXPECT_EQ(moved[2], first[2]) << "out of its range";
  EXPECT_EQ(moved[3], first[3]) << "out of its cone";
  EXPECT_EQ(at(1.5), moved);
  EXPECT_GT(at(3)[1], moved[1]) << "it has left";
  const auto rests = at(3);
  renderer_.turn_sun(77);
  const auto turned = at(4);
  EXPECT_GT(turned[0], rests[0]);
  EXPECT_TRUE(std::equal(turned.begin() + 1, turned.end(), rests.begin() + 1));
}

TEST_F(Versions, FollowTheLightItself) {
  Scene changing = scene();
  for (std::size_t k = 0; k < 3; ++k) {
    changing.lighting.sources[k].at = [k](double time_s) {
      splatbus_light_source source = k == 2 ? spot_source() : point_source();
      source.range_m = 0.1F;  // nothing else reaches it
      if (k == 0) source.intensity[0] = 1 + static_cast<float>(time_s);
      if (k == 1) source.position[2] = 0.1F * static_cast<float>(time_s);
      if (k == 2 && time_s == 1) return std::optional<splatbus_light_source>();
      return std::optional(source);
    };
  }
  Renderer renderer(shared_context(), std::move(changing));
  const auto version = [&](std::uint32_t id) { return renderer.depth_version(map_request(id, 0)); };
  renderer.set_time(0);
  const auto brightens = version(1), moves = version(2), returns = version(3);
  const std::uint64_t scene_version = renderer.scene_version();
  renderer.set_time(1);
  EXPECT_EQ(version(1), brightens);
  EXPECT_GT(version(2), moves);
  EXPECT_EQ(version(3), std::nullopt);
  EXPECT_GT(renderer.scene_version(), scene_version);
  renderer.set_time(2);
  EXPECT_GT(version(3), returns) << "no version comes again";
}

TEST_F(Versions, DecideWhatIsDrawnAgain) {
  const splatbus_camera camera = look_at({1, 3, 2}, {0, 0, 0}, 32, 32, 60);
  const auto drawn = [&](double time_s) {
    renderer_.set_time(time_s);
    static_cast<void>(renderer_.render(camera, SPLATBUS_BUFFER_COLOR));
    return std::pair(renderer_.shadow_maps_drawn(), renderer_.source_maps_drawn());
  };
  EXPECT_EQ(drawn(0), std::pair(std::uint64_t{1}, std::uint64_t{13}));
  EXPECT_EQ(drawn(0.5), std::pair(std::uint64_t{1}, std::uint64_t{13}));
  EXPECT_EQ(drawn(1.5), std::pair(std::uint64_t{2}, std::uint64_t{19})) << "the sun's, and the near light's faces";
  renderer_.set_sources_on(2);
  EXPECT_EQ(drawn(1.5).second, 31U) << "laid out anew";
}

}  // namespace
}  // namespace splatbus::sim
