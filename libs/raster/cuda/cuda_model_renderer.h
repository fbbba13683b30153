#pragma once

#include <memory>

#include "raster/model_renderer.h"

namespace splatbus::raster::cuda {

/// On the first CUDA device, on a stream of its own. Whoever wrote a model that is read in place has waited for that.
[[nodiscard]] std::unique_ptr<ModelRenderer> make_cuda_model_renderer();

}  // namespace splatbus::raster::cuda
