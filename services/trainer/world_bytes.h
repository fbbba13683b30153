#pragma once

#include <cstddef>

#include "gaussians/layout.h"

namespace splatbus::trainer {

/// What the trainer keeps of its own for each index of the model: Adam's two moments and a gradient a channel, ages,
/// votes and statistics.
[[nodiscard]] constexpr std::size_t bytes_beside(const ParameterLayout& layout) {
  return (3 * static_cast<std::size_t>(layout.channels()) + 16) * sizeof(float);
}

}  // namespace splatbus::trainer
