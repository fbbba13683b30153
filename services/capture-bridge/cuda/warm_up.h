#pragma once

#include "capture-bridge/sampler.h"

namespace splatbus::capture_bridge::cuda {

/// Samples made-up rounds, so that every kernel is loaded before the first real one: loading them takes far longer than
/// running them. Throws std::runtime_error.
void warm_up(Sampler& sampler, const RoundSizes& expected);

}  // namespace splatbus::capture_bridge::cuda
