#pragma once

#include <cstddef>
#include <string>

namespace splatbus::engine_sdk::cuda {

/// Why so many bytes do not lie at an address in memory of the first CUDA device, or an empty string.
[[nodiscard]] std::string pointer_problem(const void* address, std::size_t bytes);

}  // namespace splatbus::engine_sdk::cuda
