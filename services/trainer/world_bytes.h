#pragma once

#include <cstddef>

#include "gaussians/layout.h"
#include "model/page_store.h"
#include "raster/adam.h"

namespace splatbus::trainer {

/// What a ceiling reserves for each index of the model beside the page itself: Adam's two moments and a gradient a
/// channel, ages, votes and statistics. No step takes all of it at once; what it leaves is room for those that thaw.
[[nodiscard]] constexpr std::size_t bytes_beside(const ParameterLayout& layout) {
  return (3 * static_cast<std::size_t>(layout.channels()) + 16) * sizeof(float);
}

/// Of a page, as a ceiling counts it: what is kept beside it while it rests, and what it takes besides while it trains,
/// which is its moments.
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

/// What is kept of each index whether its page trains or not: when it came, votes, marks, what the sun sees of it.
inline constexpr std::size_t kBytesOfIndex = 16;

/// Of the model as it is, with what is kept beside it; less than a ceiling counts.
[[nodiscard]] inline std::size_t model_bytes(const model::PageStore& store) {
  const auto moments = [&](raster::PageMoments kind) {
    return raster::moment_floats(kind, static_cast<std::size_t>(store.layout().channels())) * sizeof(float);
  };
  const std::size_t rest = store.frozen_pages(), train = store.page_count() - rest;
  return store.arena_bytes() + store.view().count * kBytesOfIndex + train * moments(raster::PageMoments::Trains) +
         rest * moments(raster::PageMoments::Rests);
}

}  // namespace splatbus::trainer
