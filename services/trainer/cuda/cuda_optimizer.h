#pragma once

#include <memory>

#include "trainer/optimizer.h"

namespace splatbus::trainer {

/// Trains a model in device memory with raster::cuda::TrainStep: nothing but small figures leaves the device. Pictures
/// of a batch that differ in size, and more than raster::cuda::kMaxBatch of them, are trained one group after the other
/// within the step. Throws std::runtime_error naming the CUDA error.
[[nodiscard]] std::unique_ptr<Optimizer> make_cuda_optimizer(ModelStore& store, const Options& options);

}  // namespace splatbus::trainer
