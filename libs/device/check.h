#pragma once

#include <cuda_runtime_api.h>

#include <cstddef>

namespace splatbus::device {

/// Throws std::runtime_error with `what` and the error's words.
void check(cudaError_t status, const char* what);

/// The same for an allocation: names also how much was asked for.
void check_allocation(cudaError_t status, const char* what, std::size_t bytes);

}  // namespace splatbus::device
