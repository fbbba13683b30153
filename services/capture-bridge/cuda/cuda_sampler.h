#pragma once

#include <memory>

#include "capture-bridge/sampler.h"

namespace splatbus::capture_bridge {

/// Samples on the first CUDA device, on a stream of its own; see make_sampler. Returns when kernels are loaded and
/// memory for what is expected is there. Throws std::runtime_error.
[[nodiscard]] std::unique_ptr<Sampler> make_cuda_sampler(const RoundSizes& expected);

}  // namespace splatbus::capture_bridge
