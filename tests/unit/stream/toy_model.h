#pragma once

#include <cstdint>
#include <random>

#include "gaussians/model.h"

namespace splatbus::stream::test {

/// A rough floor of `count` flat Gaussians with smooth albedo, as the expander makes them and the trainer moves them.
/// Ids count from `first_id`. Deterministic.
inline GaussiansBuffer toy_model(std::size_t count, std::uint32_t seed, std::uint64_t first_id = 1,
                                 Appearance appearance = Appearance::Transfer, int sh_degree = 1) {
  ParameterLayout layout;
  layout.appearance = appearance;
  layout.sh_degree = sh_degree;
  GaussiansBuffer model(layout, count);
  std::mt19937 random(seed);
  std::normal_distribution<float> normal(0, 1);
  std::uniform_real_distribution<float> uniform(0, 1);
  const auto at = [&](int channel, std::size_t i) -> float& {
    return model.parameters[static_cast<std::size_t>(channel) * model.stride() + i];
  };
  const float spacing = 5 / std::sqrt(static_cast<float>(count) + 1);
  const float residual = sh_degree > 1 ? 0.12F : 0.01F;  // a colour that is another from every side
  for (std::size_t i = 0; i < count; ++i) {
    const float x = 5 * uniform(random) - 2.5F, z = 5 * uniform(random) - 2.5F;
    at(0, i) = x;
    at(1, i) = 0.1F * std::sin(3 * x) + 0.002F * normal(random);
    at(2, i) = z;
    for (int c = 0; c < 3; ++c) at(3 + c, i) = std::log(spacing * (c == 1 ? 0.1F : 0.5F)) + 0.2F * normal(random);
    at(6, i) = 1;
    for (int c = 7; c < 10; ++c) at(c, i) = 0.15F * normal(random);
    at(10, i) = 3 + normal(random);
    for (int c = 0; c < 3; ++c) {
      const float smooth = 0.4F + 0.3F * std::sin(static_cast<float>(c + 1) * x + 2 * z);
      at(11 + c, i) = appearance == Appearance::Transfer ? smooth + 0.03F * normal(random) : (smooth - 0.5F) / 0.282F;
    }
    for (int c = 14; c < layout.channels(); ++c) at(c, i) = residual * normal(random);
    const glm::vec3 n = glm::normalize(glm::vec3(-0.3F * std::cos(3 * x), 1, 0.02F * normal(random)));
    for (int c = 0; c < 3; ++c) model.normal[static_cast<std::size_t>(c) * model.stride() + i] = n[c];
    model.visibility[i] = x > 0.5F ? 0.0F : 1.0F;
    model.object_id[i] = z > 1 ? 7 : 0;
    model.gaussian_id[i] = first_id + i;
  }
  return model;
}

}  // namespace splatbus::stream::test
