#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "raster/rasterizer.h"
#include "trainer/view_store.h"

namespace splatbus::trainer {

/// mask[i] = 255 where the view (with depth, in host memory) shows a surface that the model has nothing for
/// (raster/unmodelled.h), and where the view's own mask is set; else 0. Returns how many pixels are masked for nothing
/// else.
[[nodiscard]] std::size_t mask_unmodelled(const raster::Image& alpha, const TrainingView& view, float opacity,
                                          std::vector<std::uint8_t>& mask);

}  // namespace splatbus::trainer
