#include "gaussians/light.h"

#include <algorithm>
#include <cmath>

#include "gaussians/sh.h"

namespace splatbus {

Sh9 sh9_basis(const glm::vec3& unit_direction) {
  const float x = unit_direction.x, y = unit_direction.y, z = unit_direction.z;
  return {kShC0,
          -kShC1 * y,
          kShC1 * z,
          -kShC1 * x,
          kShC2[0] * x * y,
          kShC2[1] * y * z,
          kShC2[2] * (2 * z * z - x * x - y * y),
          kShC2[3] * x * z,
          kShC2[4] * (x * x - y * y)};
}

glm::vec3 ambient_reflected(const Light& light, const glm::vec3& normal_world) {
  constexpr Sh9 kClampedCosineOverPi = {1, 2.0F / 3, 2.0F / 3, 2.0F / 3, 0.25F, 0.25F, 0.25F, 0.25F, 0.25F};
  const Sh9 basis = sh9_basis(normal_world);
  glm::vec3 sum(0);
  for (std::size_t k = 0; k < basis.size(); ++k) sum += kClampedCosineOverPi[k] * basis[k] * light.ambient_sh[k];
  return sum;
}

std::array<glm::vec3, 9> rotate_sh9(const std::array<glm::vec3, 9>& coefficients, const glm::quat& rotation) {
  // Band 1 is a vector g with f = C1 g.d, band 2 a symmetric traceless matrix M with f = d^T M d: they rotate to R g
  // and R M R^T.
  const glm::mat3 r = glm::mat3_cast(rotation);
  std::array<glm::vec3, 9> out = coefficients;
  for (int channel = 0; channel < 3; ++channel) {
    const auto c = [&](std::size_t k) { return coefficients[k][channel]; };
    const glm::vec3 g = r * glm::vec3(-c(3), -c(1), c(2));
    out[1][channel] = -g.y;
    out[2][channel] = g.z;
    out[3][channel] = -g.x;

    const float xy = 0.5F * kShC2[0] * c(4), yz = 0.5F * kShC2[1] * c(5), xz = 0.5F * kShC2[3] * c(7);
    const float zonal = kShC2[2] * c(6), difference = kShC2[4] * c(8);
    const glm::mat3 m(difference - zonal, xy, xz,   //
                      xy, -difference - zonal, yz,  //
                      xz, yz, 2 * zonal);
    const glm::mat3 rotated = r * m * glm::transpose(r);
    out[4][channel] = 2 * rotated[0][1] / kShC2[0];
    out[5][channel] = 2 * rotated[1][2] / kShC2[1];
    out[6][channel] = 0.5F * rotated[2][2] / kShC2[2];
    out[7][channel] = 2 * rotated[0][2] / kShC2[3];
    out[8][channel] = 0.5F * (rotated[0][0] - rotated[1][1]) / kShC2[4];
  }
  return out;
}

Light rotate_light(const Light& light, const glm::quat& object_from_world) {
  Light out = light;
  out.ambient_sh = rotate_sh9(light.ambient_sh, object_from_world);
  out.sun_direction = object_from_world * light.sun_direction;
  return out;
}

float srgb_from_linear(float linear) {
  const float x = std::clamp(linear, 0.0F, 1.0F);
  return x <= 0.0031308F ? 12.92F * x : 1.055F * std::pow(x, 1 / 2.4F) - 0.055F;
}

float linear_from_srgb(float srgb) {
  const float x = std::clamp(srgb, 0.0F, 1.0F);
  return x <= 0.04045F ? x / 12.92F : std::pow((x + 0.055F) / 1.055F, 2.4F);
}

}  // namespace splatbus
