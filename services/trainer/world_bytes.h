#pragma once

#include <cstddef>

#include "gaussians/layout.h"
#include "model/page_store.h"

namespace splatbus::trainer {

/// What the trainer keeps of its own for each index of the model: Adam's two moments and a gradient a channel, ages,
/// votes and statistics.
[[nodiscard]] constexpr std::size_t bytes_beside(const ParameterLayout& layout) {
  return (3 * static_cast<std::size_t>(layout.channels()) + 16) * sizeof(float);
}

/// Of the model as it is, with what is kept beside it. Frozen pages have no moments.
[[nodiscard]] inline std::size_t model_bytes(const model::PageStore& store) {
  const std::size_t moments = 2 * static_cast<std::size_t>(store.layout().channels()) * sizeof(float);
  return store.arena_bytes() + store.view().count * bytes_beside(store.layout()) -
         store.frozen_pages() * kPageLanes * moments;
}

}  // namespace splatbus::trainer
