#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "raster/rasterizer.h"
#include "trainer/view_store.h"

namespace splatbus::trainer {

/// mask[i] = 255 where the view (with depth, in host memory) shows a surface that the model has nothing for
/// (raster/unmodelled.h; `near_opacity`: Rasterizer::opacity_within(), empty without a far field), and where the view's
/// own mask is set; else 0. Returns how many pixels are masked for nothing else.
[[nodiscard]] std::size_t mask_unmodelled(const raster::Image& alpha, const TrainingView& view, float opacity,
                                          std::span<const float> near_opacity, std::vector<std::uint8_t>& mask);

}  // namespace splatbus::trainer
