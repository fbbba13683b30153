// Lights besides the sun: what the pictures show of them, against the formulas written out here.
#include <gmock/gmock.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/gtc/matrix_transform.hpp>

#include "source_scenes.h"
#include "toy_renderer.h"

namespace splatbus::sim {
namespace {

constexpr glm::vec3 kAlbedo{0.62F, 0.45F, 0.3F};

/// A floor of 4 m at y = 0 under one light and nothing else, and perhaps a block of 0.4 m at (0.5, 0.8, 0).
Scene floor_under(const splatbus_light_source& source, bool blocked) {
  Scene scene;
  add_plain(scene, box({4, 0.1F, 4}), kAlbedo, glm::translate(glm::mat4(1), {0, -0.05F, 0}));
  if (blocked) add_plain(scene, box({0.4F, 0.4F, 0.4F}), kAlbedo, glm::translate(glm::mat4(1), {0.5F, 0.8F, 0}));
  make_dark(scene.lighting);
  add_source(scene.lighting, source);
  return scene;
}

/// The header's words on splatbus_light_source, for a floor that faces +y.
glm::vec3 irradiance(const splatbus_light_source& s, const glm::vec3& p) {
  const glm::dvec3 intensity(s.intensity[0], s.intensity[1], s.intensity[2]);
  const glm::dvec3 direction(s.direction[0], s.direction[1], s.direction[2]);
  if (s.kind == SPLATBUS_LIGHT_DIRECTIONAL) return intensity * std::max(0.0, direction.y);
  const glm::dvec3 from = glm::dvec3(p) - glm::dvec3(s.position[0], s.position[1], s.position[2]);
  const double d = std::sqrt(from.x * from.x + from.y * from.y + from.z * from.z);
  const double window = std::clamp(1 - std::pow(d / double{s.range_m}, 4), 0.0, 1.0);
  double factor = window * window / (d * d) * std::max(0.0, -from.y / d);
  if (s.kind == SPLATBUS_LIGHT_SPOT) {
    const double cosine = (from.x * direction.x + from.y * direction.y + from.z * direction.z) / d;
    factor *=
        std::pow(std::clamp((cosine - double{s.cos_outer}) / (double{s.cos_inner} - double{s.cos_outer}), 0.0, 1.0), 2);
  }
  return intensity * factor;
}

/// The least distance in metres from a point of the floor to the edge of the block's shadow, below 0 within it.
float outside_shadow(const splatbus_light_source& s, const glm::vec3& p) {
  // Along the way to the light, how deep it goes into the block, or by how much it misses it.
  const glm::vec3 to_light = s.kind == SPLATBUS_LIGHT_DIRECTIONAL
                                 ? 2.0F * glm::vec3(s.direction[0], s.direction[1], s.direction[2])
                                 : glm::vec3(s.position[0], s.position[1], s.position[2]) - p;
  float best = 1e9F;
  for (int i = 0; i <= 800; ++i) {
    const glm::vec3 at = p + to_light * (static_cast<float>(i) / 800);
    const glm::vec3 out = glm::abs(at - glm::vec3(0.5F, 0.8F, 0)) - 0.2F;
    best = std::min(best, std::max(out.x, std::max(out.y, out.z)));
  }
  return best;
}

glm::vec3 bytes(const glm::vec3& irradiance) {
  glm::vec3 result;
  for (int c = 0; c < 3; ++c) result[c] = 255 * srgb_from_linear(kAlbedo[c] * irradiance[c] / 3.14159265F);
  return result;
}

/// Whether a pixel of 128 x 128 and its neighbours all show the floor.
bool alone(const std::vector<std::uint32_t>& object_id, std::uint32_t i) {
  if (i % 128 == 0 || i % 128 == 127 || i < 128 || i >= 127 * 128) return false;
  return std::ranges::all_of(std::array{i, i - 1, i + 1, i - 128, i + 128},
                             [&](std::uint32_t at) { return object_id[at] == 1; });
}

class OneSource : public testing::TestWithParam<splatbus_light_source> {};

TEST_P(OneSource, ShadesAFloorAsItsFormulaSays) {
  Renderer renderer(shared_context(), floor_under(GetParam(), false));
  const splatbus_camera camera = look_at({0.2F, 3.5F, 0.3F}, {0.2F, 0, 0.3F}, 96, 96, 45);
  const Pictures& pictures = renderer.render(camera, kAll);
  float brightest = 0, darkest = 255;
  for (std::uint32_t i = 0; i < 96 * 96; ++i) {
    const float* p = &pictures.world_position[std::size_t{4} * i];
    ASSERT_EQ(pictures.object_id[i], 1U);
    const glm::vec3 expected = bytes(irradiance(GetParam(), {p[0], p[1], p[2]}));
    const glm::vec3 found = pixel_bytes(pictures.color, 96, i % 96, i / 96);
    for (int c = 0; c < 3; ++c) ASSERT_NEAR(found[c], expected[c], 1.5F) << p[0] << ", " << p[2] << " channel " << c;
    brightest = std::max(brightest, found.x);
    darkest = std::min(darkest, found.x);
  }
  EXPECT_GT(brightest, 110);
  EXPECT_LT(brightest, 254);
  if (GetParam().kind != SPLATBUS_LIGHT_DIRECTIONAL) {
    EXPECT_LT(darkest, brightest - 40);
  }
}

TEST_P(OneSource, CastsTheBlocksShadow) {
  for (const bool casts : {true, false}) {
    splatbus_light_source source = GetParam();
    source.casts_shadow = casts ? 1 : 0;
    Renderer renderer(shared_context(), floor_under(source, true));
    // From the other side, so that the block hides none of its shadow.
    const splatbus_camera camera = look_at({-1.2F, 2.2F, 0.2F}, {0.1F, 0, 0}, 128, 128, 60);
    const Pictures& pictures = renderer.render(camera, kAll);
    int shadowed = 0, lit = 0;
    for (std::uint32_t i = 0; i < 128 * 128; ++i) {
      const float* p = &pictures.world_position[std::size_t{4} * i];
      if (!alone(pictures.object_id, i) || p[1] < -0.001F || std::max(std::abs(p[0]), std::abs(p[2])) > 1.9F) continue;
      const float outside_m = outside_shadow(source, {p[0], p[1], p[2]});
      if (std::abs(outside_m) < 0.03F) continue;
      const glm::vec3 full = bytes(irradiance(source, {p[0], p[1], p[2]}));
      const bool dark = casts && outside_m < 0;
      const glm::vec3 expected = dark ? glm::vec3(0) : full;
      const glm::vec3 found = pixel_bytes(pictures.color, 128, i % 128, i / 128);
      for (int c = 0; c < 3; ++c) ASSERT_NEAR(found[c], expected[c], 2.5F) << p[0] << ", " << p[2] << " " << casts;
      ++(dark && full.x > 20 ? shadowed : lit);
    }
    EXPECT_EQ(shadowed > 100, casts);
    EXPECT_GT(lit, 1000);
  }
}

std::string kind_name(const testing::TestParamInfo<splatbus_light_source>& source) {
  constexpr std::array<const char*, 3> kNames{"Directional", "Point", "Spot"};
  return kNames.at(source.param.kind);
}

INSTANTIATE_TEST_SUITE_P(Kinds, OneSource, testing::Values(directional_source(), point_source(), spot_source()),
                         kind_name);

TEST(Sources, SurfacesDoNotShadeThemselves) {
  for (const splatbus_light_source& source : {directional_source(), point_source(), spot_source()}) {
    splatbus_light_source through = source;
    through.casts_shadow = 0;
    Scene scene = floor_under(source, false);
    scene.objects[0].casts_shadow = true;
    for (int turn = 0; turn < 7; ++turn) {
      const glm::mat4 place = glm::translate(glm::mat4(1), {-1.2F + 0.4F * static_cast<float>(turn), 0.3F, 0.2F});
      add_plain(scene, sphere(0.12F, 48), kAlbedo, place);
    }
    Scene plain = scene;
    plain.lighting.sources.clear();
    add_source(plain.lighting, through);
    Renderer shadowed(shared_context(), scene), unshadowed(shared_context(), plain);
    // Along the light, which sees what the camera sees.
    const glm::vec3 eye = source.kind == SPLATBUS_LIGHT_DIRECTIONAL
                              ? 4.0F * glm::vec3(source.direction[0], source.direction[1], source.direction[2])
                              : glm::vec3(source.position[0], source.position[1], source.position[2]);
    const splatbus_camera camera = look_at(eye, {eye.x * 0.2F, 0, 0.2F}, 160, 160, 75);
    const std::vector<std::uint8_t> with = shadowed.render(camera, SPLATBUS_BUFFER_COLOR).color;
    const std::vector<std::uint8_t> without = unshadowed.render(camera, SPLATBUS_BUFFER_COLOR).color;
    int darker = 0, bright = 0;
    for (std::size_t i = 0; i < with.size(); i += 4) {
      darker += with[i] + 4 < without[i] ? 1 : 0;
      bright += without[i] > 60 ? 1 : 0;
    }
    EXPECT_GT(bright, 4000) << source.kind;
    // What the camera sees along the light is lit, but for edges, where a shadow begins.
    EXPECT_LT(darker, source.kind == SPLATBUS_LIGHT_DIRECTIONAL ? 700 : 350) << source.kind;
  }
}

/// What the light itself sees is lit, in whichever face of its depth maps it lies. A face that were turned or mirrored
/// would lay the plates' shadows elsewhere, for no two of them have the same place in their faces.
TEST(Sources, APointLightsFacesFitTogether) {
  Scene scene;
  splatbus_light_source source = point_source();
  make_dark(scene.lighting);
  const glm::vec3 middle{source.position[0], source.position[1], source.position[2]};
  for (int face = 0; face < 6; ++face) {
    const int axis = face / 2;
    glm::vec3 wall(0), plate(0), size(3);
    wall[axis] = face % 2 == 0 ? 1.5F : -1.5F;
    size[axis] = 0.02F;
    plate = 0.5F * wall;
    plate[(axis + 1) % 3] = 0.2F + 0.06F * static_cast<float>(face);
    plate[(axis + 2) % 3] = -0.15F;
    add_plain(scene, box(size), kAlbedo, glm::translate(glm::mat4(1), middle + wall));
    add_plain(scene, box(0.1F * size), kAlbedo, glm::translate(glm::mat4(1), middle + plate));
  }
  const auto seen_towards = [&](const glm::vec3& direction, std::uint32_t casts_shadow) {
    source.casts_shadow = casts_shadow;
    scene.lighting.sources.clear();
    add_source(scene.lighting, source);
    Renderer renderer(shared_context(), scene);
    return renderer.render(look_at(middle, middle + direction, 128, 128, 90), SPLATBUS_BUFFER_COLOR).color;
  };
  for (int face = 0; face < 6; ++face) {
    glm::vec3 direction(0);
    direction[face / 2] = face % 2 == 0 ? 1 : -1;
    const auto with = seen_towards(direction, 1), without = seen_towards(direction, 0);
    int darker = 0;
    for (std::size_t i = 0; i < with.size(); i += 4) darker += with[i] + 8 < without[i] ? 1 : 0;
    EXPECT_LT(darker, 150) << "but for the plates' edges, face " << face;
  }
}

TEST(Sources, AddUp) {
  const auto color = [](bool first, bool second) {
    Scene scene = floor_under(point_source(), true);
    scene.lighting.sources.clear();
    if (first) add_source(scene.lighting, point_source());
    if (second) add_source(scene.lighting, spot_source());
    Renderer renderer(shared_context(), std::move(scene));
    return renderer.render(look_at({-1.2F, 2.2F, 0.2F}, {0.1F, 0, 0}, 64, 64, 60), SPLATBUS_BUFFER_COLOR).color;
  };
  const auto point = color(true, false), spot = color(false, true), both = color(true, true);
  const auto linear = [](std::uint8_t byte) { return linear_from_srgb(static_cast<float>(byte) / 255); };
  for (std::size_t i = 0; i < both.size(); ++i) {
    if (i % 4 == 3 || both[i] > 250) continue;
    ASSERT_NEAR(linear(both[i]), linear(point[i]) + linear(spot[i]), 0.012F) << i;
  }
}

TEST(Sources, WhatIsEmissiveShowsItsAlbedoAndIsListedAtRest) {
  Scene scene = floor_under(point_source(), false);
  add_plain(scene, sphere(0.3F, 24), {0.8F, 0.5F, 0.1F}, glm::translate(glm::mat4(1), {0, 0.3F, 0}));
  scene.objects[1].emissive = true;
  scene.objects[1].modelled = false;
  scene.lighting.night = true;
  Renderer renderer(shared_context(), std::move(scene));
  const Pictures& pictures = renderer.render(look_at({0, 0.3F, 2}, {0, 0.3F, 0}, 64, 64, 30), kAll);
  int seen = 0;
  for (std::size_t i = 0; i < pictures.object_id.size(); ++i) {
    if (pictures.object_id[i] != 2 || pictures.color[4 * i + 3] < 255 || pictures.albedo[4 * i + 2] > 92) continue;
    ++seen;
    EXPECT_NEAR(pictures.color[4 * i], 255 * srgb_from_linear(0.8F), 0.75F);
    EXPECT_EQ(pictures.color[4 * i], pictures.albedo[4 * i]);
  }
  EXPECT_GT(seen, 300);
  ASSERT_EQ(renderer.instant().objects.size(), 1U);
  const splatbus_object& listed = renderer.instant().objects[0];
  EXPECT_EQ(listed.id, 2U);
  EXPECT_EQ(listed.flags, std::uint32_t{SPLATBUS_OBJECT_EMISSIVE | SPLATBUS_OBJECT_NOT_MODELLED});
  EXPECT_EQ(listed.scale, 1);
  EXPECT_EQ(listed.world_from_object.rotation_wxyz[0], 1);
  EXPECT_THAT(listed.world_from_object.translation, testing::Each(0));
}

TEST(Sources, AnObjectGrowsAboutItsOrigin) {
  Scene scene;
  add_plain(scene, box({1, 1, 1}), kAlbedo);
  const glm::quat turn = glm::angleAxis(0.5F, glm::normalize(glm::vec3(1, 2, 3)));
  scene.objects[0].motion = [=](double time_s) {
    return Pose{turn, {0.1F, 0.2F, 0.3F}, static_cast<float>(0.5 + time_s)};
  };
  scene.objects[0].motion_origins.add({0.1F, 0.2F, 0.3F});
  scene.objects[0].greatest_scale = 2;
  EXPECT_NEAR(scene.bounds(true).high.x, 0.1F + std::sqrt(3.0F), 1e-5F);
  Renderer renderer(shared_context(), std::move(scene));
  renderer.set_time(0.8);
  ASSERT_EQ(renderer.instant().objects.size(), 1U);
  EXPECT_FLOAT_EQ(renderer.instant().objects[0].scale, 1.3F);
  const Pictures& pictures = renderer.render(look_at({2, 3, 4}, {0, 0, 0}, 64, 64, 40), kAll);
  int seen = 0;
  for (std::size_t i = 0; i < pictures.object_id.size(); ++i) {
    if (pictures.object_id[i] == 0) continue;
    ++seen;
    const glm::vec3 p{pictures.world_position[4 * i], pictures.world_position[4 * i + 1],
                      pictures.world_position[4 * i + 2]};
    const glm::vec3 n{pictures.normal[4 * i], pictures.normal[4 * i + 1], pictures.normal[4 * i + 2]};
    const glm::vec3 in_object = glm::inverse(turn) * (p - glm::vec3(0.1F, 0.2F, 0.3F)) / 1.3F;
    const glm::vec3 size = glm::abs(in_object);
    ASSERT_NEAR(std::max(size.x, std::max(size.y, size.z)), 0.5F, 1e-4F) << "on the box's surface";
    ASSERT_NEAR(glm::length(n), 1, 1e-4F);
  }
  EXPECT_GT(seen, 500);
}

}  // namespace
}  // namespace splatbus::sim
