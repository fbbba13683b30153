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

/// Of a page: what is kept beside it while it rests, and what it takes besides while it trains, which is its moments.
struct PageCost {
  std::size_t page, beside, moments;

  explicit constexpr PageCost(const ParameterLayout& layout)
      : page(model::page_bytes(layout)),
        beside(kPageLanes * bytes_beside(layout)),
        moments(2 * static_cast<std::size_t>(layout.channels()) * kPageLanes * sizeof(float)) {
    beside -= moments;
  }
  [[nodiscard]] constexpr std::size_t all(bool trains) const { return page + beside + (trains ? moments : 0); }
};

/// Of the model as it is, with what is kept beside it.
[[nodiscard]] inline std::size_t model_bytes(const model::PageStore& store) {
  return store.arena_bytes() + store.view().count * bytes_beside(store.layout()) -
         store.frozen_pages() * PageCost(store.layout()).moments;
}

}  // namespace splatbus::trainer
