#include "gaussians/sh.h"

#include <cmath>
#include <glm/gtc/constants.hpp>

namespace splatbus {

Sh16 sh16_basis(const glm::vec3& unit_direction) {
  const float x = unit_direction.x, y = unit_direction.y, z = unit_direction.z;
  const float xx = x * x, yy = y * y, zz = z * z;
  return {kShC0,
          -kShC1 * y,
          kShC1 * z,
          -kShC1 * x,
          kShC2[0] * x * y,
          kShC2[1] * y * z,
          kShC2[2] * (2 * zz - xx - yy),
          kShC2[3] * x * z,
          kShC2[4] * (xx - yy),
          kShC3[0] * y * (3 * xx - yy),
          kShC3[1] * x * y * z,
          kShC3[2] * y * (4 * zz - xx - yy),
          kShC3[3] * z * (2 * zz - 3 * xx - 3 * yy),
          kShC3[4] * x * (4 * zz - xx - yy),
          kShC3[5] * z * (xx - yy),
          kShC3[6] * x * (xx - 3 * yy)};
}

ShRotation sh_rotation(const glm::quat& rotation) {
  // D_jk = integral of Y_j(d) Y_k(R^-1 d) over the sphere. The integrand is a polynomial of degree 6, for which four
  // Gauss-Legendre nodes in z times seven equal steps in azimuth are exact.
  constexpr std::array<double, 4> kNodes = {-0.8611363115940526, -0.3399810435848563, 0.3399810435848563,
                                            0.8611363115940526};
  constexpr std::array<double, 4> kWeights = {0.3478548451374538, 0.6521451548625461, 0.6521451548625461,
                                              0.3478548451374538};
  constexpr int kAzimuths = 7;
  std::array<std::array<double, kMaxShCoefficients>, kMaxShCoefficients> sum{};
  const glm::quat inverse_rotation = glm::conjugate(rotation);
  for (std::size_t node = 0; node < kNodes.size(); ++node) {
    const double z = kNodes[node], radius = std::sqrt(1 - z * z);
    for (int a = 0; a < kAzimuths; ++a) {
      const double phi = glm::two_pi<double>() * a / kAzimuths;
      const glm::vec3 direction(glm::dvec3(radius * std::cos(phi), radius * std::sin(phi), z));
      const Sh16 here = sh16_basis(direction);
      const Sh16 there = sh16_basis(inverse_rotation * direction);
      const double weight = kWeights[node] * glm::two_pi<double>() / kAzimuths;
      for (std::size_t j = 0; j < here.size(); ++j) {
        for (std::size_t k = 0; k < there.size(); ++k) sum[j][k] += weight * here[j] * there[k];
      }
    }
  }
  ShRotation matrix{};
  constexpr std::array<std::size_t, 5> kBandBegin = {0, 1, 4, 9, 16};
  for (std::size_t band = 0; band < 4; ++band) {
    for (std::size_t j = kBandBegin[band]; j < kBandBegin[band + 1]; ++j) {
      for (std::size_t k = kBandBegin[band]; k < kBandBegin[band + 1]; ++k)
        matrix[j][k] = static_cast<float>(sum[j][k]);
    }
  }
  return matrix;
}

}  // namespace splatbus
