#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "raster/rasterizer.h"
#include "trainer/view_store.h"

namespace splatbus::trainer {

/// mask[i] = 255 where the view (with depth, in host memory) shows a surface that the model has nothing for, and where
/// the view's own mask is set; else 0. Nothing is there for a pixel whose opacity `alpha` is below `opacity`, and which
/// stands among others of that kind: in its square of kUnmodelledSide pixels the mean over those with a surface is
/// below it, too. A small hole in what is modelled is so left to be closed. Pixels without a surface are sky, and must
/// come to be empty. Returns how many pixels are masked for nothing else.
[[nodiscard]] std::size_t mask_unmodelled(const raster::Image& alpha, const TrainingView& view, float opacity,
                                          std::vector<std::uint8_t>& mask);
inline constexpr std::uint32_t kUnmodelledSide = 8;

}  // namespace splatbus::trainer
