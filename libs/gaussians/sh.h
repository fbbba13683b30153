#pragma once

#include <array>
#include <glm/glm.hpp>
#include <glm/gtc/quaternion.hpp>

namespace splatbus {

// Real spherical harmonics, constants and signs as in 3DGS (Kerbl et al. 2023, `eval_sh`): l = 0 | 1: m = -1, 0, 1 |
// 2: m = -2 .. 2 | 3: m = -3 .. 3, with the Condon-Shortley sign on odd m.
inline constexpr int kMaxShDegree = 3;
inline constexpr int kMaxShCoefficients = 16;
inline constexpr float kShC0 = 0.28209479177387814F;
inline constexpr float kShC1 = 0.4886025119029199F;
inline constexpr std::array<float, 5> kShC2 = {1.0925484305920792F, -1.0925484305920792F, 0.31539156525252005F,
                                               -1.0925484305920792F, 0.5462742152960396F};
inline constexpr std::array<float, 7> kShC3 = {-0.5900435899266435F, 2.890611442640554F,   -0.4570457994644658F,
                                               0.3731763325901154F,  -0.4570457994644658F, 1.445305721320277F,
                                               -0.5900435899266435F};

using Sh16 = std::array<float, kMaxShCoefficients>;

/// All 16 basis functions of degree 3 at a unit direction; a lower degree is a prefix.
[[nodiscard]] Sh16 sh16_basis(const glm::vec3& unit_direction);

/// The matrix D, rows by columns, for which D c are the coefficients of f(R^-1 d) when c are those of f(d), degree 3.
/// It is block-diagonal by band; a lower degree is its upper left corner.
using ShRotation = std::array<Sh16, kMaxShCoefficients>;
[[nodiscard]] ShRotation sh_rotation(const glm::quat& rotation);

}  // namespace splatbus
