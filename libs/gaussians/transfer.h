#pragma once

#include <array>
#include <cstddef>
#include <glm/glm.hpp>
#include <span>

#include "gaussians/model.h"

namespace splatbus {

/// What the colour of a Transfer Gaussian depends on, in its object's frame.
struct TransferValues {
  glm::vec3 mean{0}, normal{0, 1, 0}, albedo{0};
  std::array<glm::vec3, 9> residual{};
};

/// Linear colour by the formula of ParameterLayout, at least 0. `light` is in the frame of the Gaussian's object
/// (light_in_object()). `visibility` in [0, 1], [1 + sources]: the sun's, then those of light.sources.
[[nodiscard]] glm::vec3 shade_transfer(const TransferValues& gaussian, std::span<const float> visibility,
                                       const Light& light_object);

/// The same of Gaussian i of a Transfer model. Reads parameters, normal and visibility; without any no light is
/// blocked.
[[nodiscard]] glm::vec3 shade_transfer(const GaussiansView& gaussians, std::size_t i, const Light& light_object);

}  // namespace splatbus
