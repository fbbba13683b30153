#pragma once

#include <memory>

#include "raster/rasterizer.h"

namespace splatbus::raster {

/// The Rasterizer interface on the first CUDA device, over host memory: every call copies in and out. Throws
/// std::runtime_error naming the CUDA error when there is no usable device.
[[nodiscard]] std::unique_ptr<Rasterizer> make_cuda_rasterizer();

}  // namespace splatbus::raster
