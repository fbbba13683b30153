#pragma once

#include "gaussians/layout.h"

namespace splatbus::trainer {

/// Trains a small model of this layout for a few steps, once a process, so that the driver has loaded every kernel of a
/// step, and the first step of the true model takes no longer than the others. Throws std::runtime_error naming the
/// CUDA error.
void warm_up(const ParameterLayout& layout);

}  // namespace splatbus::trainer
