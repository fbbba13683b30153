#pragma once

#include <memory>

#include "relight/visibility_backend.h"

namespace splatbus::relight {

/// compute_visibility on the first CUDA device, on a stream of its own that is waited for. Whoever wrote the device
/// memory that it reads has waited for that. Throws std::runtime_error.
[[nodiscard]] std::unique_ptr<VisibilityBackend> make_cuda_visibility();

}  // namespace splatbus::relight
