#include "gaussians/light.h"

#include <gtest/gtest.h>

#include "gaussians/sh.h"
#include "random.h"

namespace splatbus {
namespace {

glm::vec3 evaluate(const std::array<glm::vec3, 9>& coefficients, const glm::vec3& direction) {
  const Sh9 basis = sh9_basis(direction);
  glm::vec3 sum(0);
  for (std::size_t k = 0; k < basis.size(); ++k) sum += basis[k] * coefficients[k];
  return sum;
}

TEST(Sh9, IsThePrefixOfSh16) {
  test::Random random(3);
  for (int i = 0; i < 50; ++i) {
    const glm::vec3 d = random.direction();
    const Sh9 nine = sh9_basis(d);
    const Sh16 sixteen = sh16_basis(d);
    for (std::size_t k = 0; k < nine.size(); ++k) EXPECT_FLOAT_EQ(nine[k], sixteen[k]);
  }
}

TEST(Sh9, RotationEqualsEvaluatingTheRotatedDirection) {
  test::Random random(4);
  for (int i = 0; i < 200; ++i) {
    const Light light = random.light();
    const glm::quat rotation = random.rotation();
    const auto rotated = rotate_sh9(light.ambient_sh, rotation);
    const glm::vec3 d = random.direction();
    const glm::vec3 expected = evaluate(light.ambient_sh, glm::conjugate(rotation) * d);
    EXPECT_LE(glm::distance(evaluate(rotated, d), expected), 3e-6F);
  }
}

TEST(Light, RotatesWithItsSun) {
  test::Random random(5);
  const Light light = random.light();
  const glm::quat object_from_world = random.rotation();
  const Light local = light_in_object(light, Rigid{.rotation = glm::conjugate(object_from_world), .translation = {}});
  const glm::vec3 n = random.direction();
  EXPECT_LE(glm::distance(ambient_reflected(light, n), ambient_reflected(local, object_from_world * n)), 3e-6F);
  EXPECT_NEAR(glm::dot(light.sun_direction, n), glm::dot(local.sun_direction, object_from_world * n), 1e-6F);
  EXPECT_EQ(local.sun_irradiance, light.sun_irradiance);
  EXPECT_EQ(local.background, light.background);
}

TEST(Light, APointLightFallsOffWithTheSquareOfTheDistanceUpToItsRange) {
  const LightSource lamp{.id = 1, .position = {1, 0, 0}, .intensity = {8, 4, 0}, .range_m = 4};
  const Incident near = incident(lamp, {1, 2, 0});
  EXPECT_EQ(near.to_light, glm::vec3(0, -1, 0));
  const float window = 1 - 1.0F / 16;  // (2 / 4)^4
  EXPECT_LE(glm::distance(near.irradiance, window * window * glm::vec3(2, 1, 0)), 1e-6F);
  EXPECT_EQ(incident(lamp, {1, 4, 0}).irradiance, glm::vec3(0));
  EXPECT_EQ(incident(lamp, {1, 40, 0}).irradiance, glm::vec3(0));
  EXPECT_TRUE(glm::all(glm::lessThanEqual(incident(lamp, {1, 0, 0}).irradiance, glm::vec3(80001, 40001, 0))));
}

TEST(Light, ASpotFadesFromItsInnerToItsOuterCone) {
  const LightSource spot{.id = 1,
                         .kind = LightKind::Spot,
                         .position = {0, 0, 0},
                         .direction = {0, 0, 1},
                         .intensity = glm::vec3(1),
                         .range_m = 1e6F,
                         .cos_inner = 0.9F,
                         .cos_outer = 0.7F};
  const auto at_cosine = [&](float cosine) {
    return incident(spot, {std::sqrt(1 - cosine * cosine), 0, cosine}).irradiance.x;
  };
  EXPECT_NEAR(at_cosine(0.95F), 1, 1e-5F);
  EXPECT_NEAR(at_cosine(0.8F), 0.25F, 1e-5F);
  EXPECT_EQ(at_cosine(0.69F), 0);
  EXPECT_EQ(at_cosine(-0.95F), 0);
}

TEST(Light, ADirectionalLightIsTheSameEverywhere) {
  const LightSource moon{.id = 1, .kind = LightKind::Directional, .direction = {0, 0.6F, 0.8F}, .intensity = {1, 2, 3}};
  for (const glm::vec3 point : {glm::vec3(0), glm::vec3(1e4F, -3, 2)}) {
    EXPECT_EQ(incident(moon, point).to_light, moon.direction);
    EXPECT_EQ(incident(moon, point).irradiance, moon.intensity);
  }
}

TEST(Light, SourcesShineOnAnObjectAsTheyDoInTheWorld) {
  test::Random random(7);
  Light light = random.light();
  light.sources = {{.id = 1, .position = {2, 1, 0}, .intensity = {3, 2, 1}, .range_m = 9},
                   {.id = 2,
                    .kind = LightKind::Spot,
                    .position = {-1, 3, 0},
                    .direction = glm::normalize(glm::vec3(0.2F, -1, 0.1F)),
                    .intensity = {5, 5, 5},
                    .range_m = 12,
                    .cos_inner = 0.8F,
                    .cos_outer = -0.5F},
                   {.id = 3, .kind = LightKind::Directional, .direction = {0, 1, 0}, .intensity = {1, 1, 0}}};
  ObjectTransform object = random.rigid();
  object.scale = 2.5F;
  const Light local = light_in_object(light, object);
  const glm::vec3 point(0.3F, -0.2F, 0.4F);
  for (std::size_t k = 0; k < light.sources.size(); ++k) {
    const Incident expected = incident(light.sources[k], object * point), seen = incident(local.sources[k], point);
    EXPECT_GT(expected.irradiance.x, 0);
    EXPECT_LE(glm::distance(object.rigid.rotation * seen.to_light, expected.to_light), 1e-5F);
    EXPECT_LE(glm::distance(seen.irradiance, expected.irradiance), 1e-4F * glm::length(expected.irradiance));
  }
  EXPECT_LE(glm::distance(object_point(object, object * point), point), 1e-5F);
}

TEST(Light, WhatIsEmissiveIsNotLit) {
  test::Random random(8);
  Light light = random.light();
  light.sources = {{.id = 1, .intensity = {3, 2, 1}}};
  ObjectTransform lamp = random.rigid();
  lamp.emissive = true;
  const Light local = light_in_object(light, lamp);
  for (int i = 0; i < 10; ++i) {
    EXPECT_LE(glm::distance(ambient_reflected(local, random.direction()), glm::vec3(1)), 1e-6F);
  }
  EXPECT_EQ(local.sun_irradiance, glm::vec3(0));
  EXPECT_TRUE(local.sources.empty());
  EXPECT_EQ(local.background, light.background);
}

TEST(Light, AmbientReflectedIsTheIntegralOfTheClampedCosine) {
  test::Random random(6);
  for (int i = 0; i < 4; ++i) {
    const Light light = random.light();
    const glm::vec3 n = random.direction();
    constexpr int kRings = 200, kSectors = 400;
    glm::dvec3 sum(0);
    for (int ring = 0; ring < kRings; ++ring) {
      const float z = -1 + 2 * (static_cast<float>(ring) + 0.5F) / kRings, r = std::sqrt(1 - z * z);
      for (int sector = 0; sector < kSectors; ++sector) {
        const float phi = glm::two_pi<float>() * static_cast<float>(sector) / kSectors;
        const glm::vec3 d(r * std::cos(phi), r * std::sin(phi), z);
        sum += glm::dvec3(std::max(0.0F, glm::dot(n, d)) * evaluate(light.ambient_sh, d));
      }
    }
    const double solid_angle = 2 * glm::two_pi<double>() / (kRings * kSectors);
    const glm::vec3 expected(sum * solid_angle / glm::pi<double>());
    EXPECT_LE(glm::distance(ambient_reflected(light, n), expected), 1e-4F);
  }
}

TEST(Light, UniformRadianceIsReflectedAsItIs) {
  Light light;
  light.ambient_sh[0] = glm::vec3(0.7F, 0.5F, 0.25F) / kShC0;
  EXPECT_LE(glm::distance(ambient_reflected(light, {0, 1, 0}), {0.7F, 0.5F, 0.25F}), 1e-6F);
}

TEST(Srgb, CurvesAreInverseAndMeetKnownValues) {
  EXPECT_EQ(srgb_from_linear(0), 0);
  EXPECT_NEAR(srgb_from_linear(1), 1, 1e-6F);
  EXPECT_NEAR(srgb_from_linear(0.5F), 0.7353569F, 1e-5F);
  EXPECT_NEAR(srgb_from_linear(0.001F), 0.01292F, 1e-6F);
  EXPECT_NEAR(linear_from_srgb(0.5F), 0.2140411F, 1e-5F);
  for (int i = 0; i <= 255; ++i) {
    const float srgb = static_cast<float>(i) / 255;
    EXPECT_NEAR(srgb_from_linear(linear_from_srgb(srgb)), srgb, 1e-6F);
  }
  EXPECT_EQ(srgb_from_linear(-1), 0);
  EXPECT_NEAR(srgb_from_linear(7), 1, 1e-6F);
}

}  // namespace
}  // namespace splatbus
