#pragma once

#include <array>
#include <cstddef>
#include <glm/glm.hpp>
#include <glm/gtc/quaternion.hpp>

#include "gaussians/model.h"
#include "gaussians/sh.h"

namespace splatbus::splats {

/// A Gaussian as files have it: in the world's frame, its appearance SH of the colour in display space.
struct Splat {
  glm::vec3 mean{0};                               ///< metres
  glm::vec3 normal{0};                             ///< unit, or zero where there is none
  glm::vec3 log_scale{0};                          ///< metres
  glm::quat rotation{1, 0, 0, 0};                  ///< unit, w x y z
  float opacity_logit = 0;                         ///< opacity = 1 / (1 + exp(-logit))
  std::array<glm::vec3, kMaxShCoefficients> sh{};  ///< colour = 0.5 + sum over sh16_basis()
};

/// Gaussian i of a Radiance model without pages, as it lies there: no object's frame is applied. Reads parameters and
/// normal.
[[nodiscard]] Splat load(const GaussiansView& radiance, std::size_t i);
/// The other way; coefficients that the model's degree has no room for are dropped. Sets surface_point to the mean,
/// gaussian_id to i.
void store(const Splat& splat, GaussiansBuffer& radiance, std::size_t i);

}  // namespace splatbus::splats
