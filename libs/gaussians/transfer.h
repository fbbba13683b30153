#pragma once

#include <cstddef>
#include <glm/glm.hpp>

#include "gaussians/model.h"

namespace splatbus {

/// Linear colour of Gaussian i of a Transfer model, by the formula of ParameterLayout, at least 0. `light` is in the
/// frame of the Gaussian's object (light_in_object()). Reads parameters, normal and visibility; without any no
/// light is blocked.
[[nodiscard]] glm::vec3 shade_transfer(const GaussiansView& gaussians, std::size_t i, const Light& light_object);

}  // namespace splatbus
