#pragma once

#include <algorithm>
#include <vector>

#include "gaussians/model.h"
#include "raster/cpu/workers.h"

namespace splatbus::raster::cpu {

/// The Gaussians of a model cut into pieces of at most `most`, a power of two, none of which crosses a page. A piece's
/// frame_id says whose frame it is in where the model has no object ids.
inline void cut_pieces(const GaussiansView& gaussians, std::uint32_t most, std::vector<IndexRange>& pieces) {
  pieces.clear();
  const auto cut = [&](const IndexRange& range) {
    const std::uint32_t end = range.first + range.count;
    for (std::uint32_t first = range.first; first < end; first = (first / most + 1) * most) {
      pieces.push_back({first, std::min(end, (first / most + 1) * most) - first, range.frame_id, range.frozen});
    }
  };
  if (gaussians.has_pages()) {
    std::for_each(gaussians.ranges.begin(), gaussians.ranges.end(), cut);
  } else {
    cut({0, static_cast<std::uint32_t>(gaussians.count)});
  }
}

}  // namespace splatbus::raster::cpu
