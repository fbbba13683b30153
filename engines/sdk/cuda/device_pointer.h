#pragma once

#include <string>

namespace splatbus::engine_sdk::cuda {

/// Why an address is not in memory of the first CUDA device, or an empty string.
[[nodiscard]] std::string pointer_problem(const void* address);

}  // namespace splatbus::engine_sdk::cuda
