#include "gaussians/transfer.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <glm/gtc/constants.hpp>

namespace splatbus {

namespace {

/// Of the sun, 0, and the sources, 1 and on.
float visibility_of(const GaussiansView& gaussians, std::size_t light, std::size_t i) {
  if (gaussians.visibility_u8 != nullptr && light < gaussians.visibility_rows) {
    return static_cast<float>(gaussians.visibility_u8[light * gaussians.visibility_stride + i]) / 255;
  }
  return light == 0 && gaussians.visibility != nullptr ? gaussians.visibility[i] : 1.0F;
}

}  // namespace

glm::vec3 shade_transfer(const TransferValues& gaussian, std::span<const float> visibility, const Light& light_object) {
  assert(visibility.size() == 1 + light_object.sources.size());
  constexpr auto kInversePi = glm::one_over_pi<float>();
  glm::vec3 reflected = ambient_reflected(light_object, gaussian.normal);
  std::array<glm::vec3, 9> arriving = light_object.ambient_sh;
  const auto add = [&](const glm::vec3& to_light, const glm::vec3& irradiance, float seen) {
    const glm::vec3 light = seen * kInversePi * irradiance;
    reflected += std::max(0.0F, glm::dot(gaussian.normal, to_light)) * light;
    const Sh9 basis = sh9_basis(to_light);
    for (std::size_t k = 0; k < 9; ++k) arriving[k] += basis[k] * light;
  };
  add(light_object.sun_direction, light_object.sun_irradiance, visibility[0]);
  for (std::size_t j = 0; j < light_object.sources.size(); ++j) {
    const Incident source = incident(light_object.sources[j], gaussian.mean);
    add(source.to_light, source.irradiance, visibility[1 + j]);
  }
  glm::vec3 color = gaussian.albedo * reflected;
  for (std::size_t k = 0; k < 9; ++k) color += gaussian.residual[k] * arriving[k];
  return glm::max(color, glm::vec3(0));
}

glm::vec3 shade_transfer(const GaussiansView& gaussians, std::size_t i, const Light& light_object) {
  assert(gaussians.layout.appearance == Appearance::Transfer && i < gaussians.count);
  const auto triple = [i, &gaussians](const float* planes) {
    return glm::vec3(planes[i], planes[gaussians.stride + i], planes[2 * gaussians.stride + i]);
  };
  TransferValues values{.mean = triple(gaussians.plane(ParameterLayout::kMean)),
                        .normal = triple(gaussians.normal),
                        .albedo = triple(gaussians.plane(ParameterLayout::kAlbedo)),
                        .residual = {}};
  for (int k = 0; k < 9; ++k) {
    values.residual[static_cast<std::size_t>(k)] = triple(gaussians.plane(ParameterLayout::kResidual + 3 * k));
  }
  std::array<float, 1 + kMaxLightSources> visibility{};
  const std::size_t lights = 1 + light_object.sources.size();
  assert(lights <= visibility.size());
  for (std::size_t j = 0; j < lights; ++j) visibility[j] = visibility_of(gaussians, j, i);
  return shade_transfer(values, {visibility.data(), lights}, light_object);
}

}  // namespace splatbus
