#pragma once

#include <cstddef>

namespace splatbus::bus {

/// Tensors that lie one after the other each begin at a multiple of this many bytes.
constexpr std::size_t tensor_alignment = 64;

/// `bytes`, rounded up to where the next tensor may begin.
[[nodiscard]] constexpr std::size_t aligned(std::size_t bytes) {
  return (bytes + tensor_alignment - 1) / tensor_alignment * tensor_alignment;
}

}  // namespace splatbus::bus
