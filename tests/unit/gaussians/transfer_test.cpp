#include "gaussians/transfer.h"

#include <gtest/gtest.h>

#include "gaussians/sh.h"
#include "random.h"

namespace splatbus {
namespace {

/// One Gaussian, all zero but what is set.
GaussiansBuffer one(const glm::vec3& albedo, const glm::vec3& normal, float visibility) {
  GaussiansBuffer buffer({}, 1);
  for (int c = 0; c < 3; ++c) {
    const auto channel = static_cast<std::size_t>(c);
    buffer.parameters[(ParameterLayout::kAlbedo + channel) * buffer.stride()] = albedo[c];
    buffer.normal[channel * buffer.stride()] = normal[c];
  }
  buffer.visibility[0] = visibility;
  return buffer;
}

TEST(Transfer, SunFallsOffWithTheCosineAndTheVisibility) {
  Light light;
  light.sun_direction = {0, 1, 0};
  light.sun_irradiance = glm::vec3(glm::pi<float>(), 0, 2 * glm::pi<float>());
  const glm::vec3 albedo(0.5F, 1, 0.25F);
  const auto shade = [&](const glm::vec3& normal, float visibility) {
    return shade_transfer(one(albedo, normal, visibility).view(), 0, light);
  };
  EXPECT_LE(glm::distance(shade({0, 1, 0}, 1), {0.5F, 0, 0.5F}), 1e-6F);
  EXPECT_LE(glm::distance(shade({0, 1, 0}, 0.5F), {0.25F, 0, 0.25F}), 1e-6F);
  EXPECT_LE(glm::distance(shade({0.8F, 0.6F, 0}, 1), {0.3F, 0, 0.3F}), 1e-6F);
  EXPECT_EQ(shade({0, -1, 0}, 1), glm::vec3(0)) << "turned away";
}

TEST(Transfer, AmbientIsReflectedByTheAlbedo) {
  test::Random random(11);
  Light light = random.light();
  light.sun_irradiance = glm::vec3(0);
  light.ambient_sh[0] = glm::vec3(5);
  const glm::vec3 albedo(0.2F, 0.4F, 0.6F), n = random.direction();
  EXPECT_LE(glm::distance(shade_transfer(one(albedo, n, 1).view(), 0, light), albedo * ambient_reflected(light, n)),
            1e-6F);
}

TEST(Transfer, ResidualSeesAmbientAndSun) {
  test::Random random(12);
  const Light light = random.light();
  GaussiansBuffer buffer = one(glm::vec3(0), {0, 0, 1}, 0.5F);
  const std::size_t k = 6;
  const glm::vec3 weight(0.3F, -0.2F, 40);
  for (int c = 0; c < 3; ++c) {
    buffer.parameters[(ParameterLayout::kResidual + 3 * k + static_cast<std::size_t>(c)) * buffer.stride()] = weight[c];
  }
  const glm::vec3 sun = light.sun_irradiance * sh9_basis(light.sun_direction)[k] / glm::pi<float>();
  const glm::vec3 expected = glm::max(glm::vec3(0), weight * (light.ambient_sh[k] + 0.5F * sun));
  EXPECT_LE(glm::distance(shade_transfer(buffer.view(), 0, light), expected), 1e-5F);
}

TEST(Transfer, SourcesAddWithTheirOwnRowsOfVisibility) {
  Light light;
  light.sun_irradiance = glm::vec3(glm::pi<float>());
  // A lamp 2 m above, and light from the side that leaves the surface alone but meets the residual.
  light.sources = {
      {.id = 3, .position = {0, 2, 0}, .intensity = glm::pi<float>() * glm::vec3(4, 8, 0), .range_m = 1e4F},
      {.id = 4, .kind = LightKind::Directional, .direction = {1, 0, 0}, .intensity = {0, 0, glm::pi<float>()}}};
  GaussiansBuffer buffer = one(glm::vec3(0.5F), {0, 1, 0}, 0.25F);
  const auto residual = [&](std::size_t k, std::size_t c) -> float& {
    return buffer.parameters[(ParameterLayout::kResidual + 3 * k + c) * buffer.stride()];
  };
  residual(3, 2) = -2;  // sees -x
  GaussiansView view = buffer.view();
  const float side = 2 * kShC1;
  EXPECT_LE(glm::distance(shade_transfer(view, 0, light), {0.625F, 1.125F, 0.125F + side}), 1e-5F) << "not shadowed";
  const std::vector<std::uint8_t> rows{0, 255, 9, 51, 9, 204};
  view.visibility_u8 = rows.data() + 1;
  view.visibility_stride = 2;
  view.visibility_rows = 3;
  EXPECT_LE(glm::distance(shade_transfer(view, 0, light), {0.6F, 0.7F, 0.5F + 0.8F * side}), 1e-5F);
  view.visibility_rows = 2;
  EXPECT_LE(glm::distance(shade_transfer(view, 0, light), {0.6F, 0.7F, 0.5F + side}), 1e-5F) << "has no row";
}

}  // namespace
}  // namespace splatbus
