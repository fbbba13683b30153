#include "gaussians/transfer.h"

#include <algorithm>
#include <cassert>
#include <glm/gtc/constants.hpp>

namespace splatbus {

glm::vec3 shade_transfer(const GaussiansView& gaussians, std::size_t i, const Light& light_object) {
  assert(gaussians.layout.appearance == Appearance::Transfer && i < gaussians.count);
  constexpr auto kInversePi = glm::one_over_pi<float>();
  const auto triple = [i, &gaussians](const float* planes) {
    return glm::vec3(planes[i], planes[gaussians.stride + i], planes[2 * gaussians.stride + i]);
  };
  const glm::vec3 normal = triple(gaussians.normal);
  const glm::vec3 albedo = triple(gaussians.plane(ParameterLayout::kAlbedo));
  const float visibility = gaussians.visibility != nullptr ? gaussians.visibility[i] : 1.0F;
  const glm::vec3 sun = visibility * kInversePi * light_object.sun_irradiance;
  const float cosine = std::max(0.0F, glm::dot(normal, light_object.sun_direction));
  glm::vec3 color = albedo * (ambient_reflected(light_object, normal) + cosine * sun);
  const Sh9 sun_basis = sh9_basis(light_object.sun_direction);
  for (int k = 0; k < 9; ++k) {
    const auto coefficient = static_cast<std::size_t>(k);
    color += triple(gaussians.plane(ParameterLayout::kResidual + 3 * k)) *
             (light_object.ambient_sh[coefficient] + sun_basis[coefficient] * sun);
  }
  return glm::max(color, glm::vec3(0));
}

}  // namespace splatbus
