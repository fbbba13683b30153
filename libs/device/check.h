#pragma once

#include <cuda_runtime_api.h>

namespace splatbus::device {

/// Throws std::runtime_error with `what` and the error's words.
void check(cudaError_t status, const char* what);

}  // namespace splatbus::device
