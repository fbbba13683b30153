#pragma once

#include <cstdint>

namespace splatbus {

enum class Appearance : std::uint8_t { Transfer, Radiance };

/// Where each trainable channel of a Gaussian lies. Parameters are planes of floats: channel c of Gaussian i is
/// parameters[c * stride + i].
///
///   0..2   mean, metres, in the frame of the Gaussian's object       3..5  log of the scale, metres
///   6..9   rotation quaternion w x y z, normalised where it is used  10    opacity logit
///   Transfer: 11..13 albedo, linear RGB; 14..40 residual transfer, 14 + 3 k + c for SH coefficient k and colour c
///   Radiance: 11 + 3 k + c, SH coefficient k of colour c, (degree + 1)^2 coefficients; colour = 0.5 + sum, display
///   space
///
/// Transfer shading, linear, at least 0, with a sum over the lights j, the sun and Light::sources:
/// colour_c = albedo_c (E_c(n) + sum_j v_j e_jc max(0, n.l_j) / pi) + sum_k R_kc (A_kc + sum_j v_j e_jc Y_k(l_j) / pi),
/// with E = ambient_reflected, A the ambient SH, v_j the visibility, and l_j, e_j where the light is and its
/// irradiance: of a source incident() at the mean, which counts as fixed there (no gradient leads through a light to
/// it). n, A, l in the object's frame.
struct ParameterLayout {
  static constexpr int kMean = 0, kLogScale = 3, kRotation = 6, kOpacityLogit = 10, kAppearance = 11;
  static constexpr int kAlbedo = 11, kResidual = 14;

  Appearance appearance = Appearance::Transfer;
  int sh_degree = 3;  ///< Radiance only, 0 to 3

  [[nodiscard]] constexpr int sh_coefficients() const { return (sh_degree + 1) * (sh_degree + 1); }
  [[nodiscard]] constexpr int channels() const {
    return appearance == Appearance::Transfer ? 41 : 11 + 3 * sh_coefficients();
  }
  bool operator==(const ParameterLayout&) const = default;
};

/// Bits of the flags plane.
enum GaussianFlags : std::uint32_t { kFrozen = 1U };

}  // namespace splatbus
