#pragma once

#include <cstdint>

#include "raster/cuda/column_planes.h"
#include "raster/cuda/kernels.h"

namespace splatbus::raster::cuda {

/// Owner of what a training step keeps for each Gaussian of a model on the device: Adam's moments, planes
/// [channels][stride] beside the model's, and statistics where they are gathered. All work is enqueued on the stream
/// that is given. Throws std::runtime_error naming the CUDA error.
class AdamState {
 public:
  /// Everything begins anew.
  void reset(const ParameterLayout& layout, int count, std::int64_t stride, cudaStream_t stream);
  /// Columns below both counts stay as they are, all others begin anew. Only a change of stride allocates, and waits.
  void resize(int count, std::int64_t stride, cudaStream_t stream);
  /// Column from[k] replaces column to[k]; device arrays without an index in common.
  void move(const std::uint32_t* from, const std::uint32_t* to, int count, cudaStream_t stream);
  /// Begins to gather statistics, or gives their memory back.
  void gather_statistics(bool gather, cudaStream_t stream);
  void clear_statistics(cudaStream_t stream);

  [[nodiscard]] OptimizerState view() const {
    return {.first = first_.data(), .second = second_.data(), .steps = steps_.data()};
  }
  /// Null where they are not gathered.
  [[nodiscard]] ScreenStatistics statistics() const {
    return {.mean2d_norm = mean2d_norm_.data(), .steps = mean2d_steps_.data()};
  }
  [[nodiscard]] std::size_t bytes() const {
    return first_.bytes() + second_.bytes() + steps_.bytes() + mean2d_norm_.bytes() + mean2d_steps_.bytes();
  }

 private:
  int count_ = 0;
  std::int64_t stride_ = 0;
  bool gathers_ = false;
  ColumnPlanes<float> first_, second_;
  ColumnPlanes<std::uint32_t> steps_;
  ColumnPlanes<float> mean2d_norm_;
  ColumnPlanes<std::uint32_t> mean2d_steps_;
};

}  // namespace splatbus::raster::cuda
